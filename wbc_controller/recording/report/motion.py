"""Motion for the 3-D view."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.controller.visualization.geometry import Part, build_parts
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.report.run_data import RunData
from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings, SurfaceContact

FRAME_RATE = 30.0
MAX_FRAMES = 3600  # limits the size of the page; long runs have fewer frames per second
_INT16 = 32767


def make_motion(run: RunData, model: RobotModel) -> dict[str, Any]:
    """Return the JSON input of ``replay.js``, with arrays as base64 of little-endian bytes.

    Unreadable visual geometry or an unknown frame raises `ConfigurationError`, a run of another robot `ValueError`.
    """
    if run.q.shape[1] != model.nq:
        raise ValueError(f"q of the run has {run.q.shape[1]} columns; the robot's model has {model.nq}")
    parts = build_parts(model)
    frames = frame_indices(run.time)
    time = run.time[frames]
    contacts = [name for name in run.contact_wrenches if name in run.contacts]
    carriers = {name: contact_placement(model, name, run.contacts[name]) for name in contacts}
    # A robot without shapes has only its centre of mass, in the world frame.
    joints = sorted({part.joint for part in parts} | {joint for joint, _ in carriers.values()}) or [0]
    poses = joint_poses(run.q[frames], model, joints)
    forces = np.zeros((len(frames), len(contacts), 2, 6))
    for i, name in enumerate(contacts):
        joint, placement = carriers[name]
        pose = poses[:, joints.index(joint)]
        for j, wrenches in enumerate((run.contact_wrenches, run.true_wrenches)):
            if name in wrenches:
                forces[:, i, j] = _force_lines(wrenches[name][frames], pose, placement)
    return {
        "duration": float(time[-1]),
        "start": float(time[0]),
        "time": _base64(time, "<f4"),
        "joints": len(joints),
        "poses": encode_poses(poses),
        "parts": [
            {
                "joint": joints.index(part.joint),
                "color": [round(255 * share) for share in part.color],
                "vertices": np.round(part.vertices, 4).ravel().tolist(),
                "triangles": part.triangles.ravel().tolist(),
            }
            for part in parts
        ],
        "contacts": [
            {
                "name": name,
                "joint": joints.index(carriers[name][0]),
                "corners": _corners(run.contacts[name], carriers[name][1]),
            }
            for name in contacts
        ],
        "forces": _base64(np.nan_to_num(forces), "<f4"),
        "forces_are_true": bool(run.true_wrenches),
        "com": _base64(np.hstack([run.com[frames], run.com_reference[frames]]), "<f4"),
        "weight": model.mass * model.gravity,
        "size": _size(parts, poses[0], joints),
        "phases": run.spans,
        "modes": list(run.modes),
    }


def frame_indices(time: Array) -> npt.NDArray[np.intp]:
    """Return evenly spaced samples, including both ends."""
    count = int(np.clip((time[-1] - time[0]) * FRAME_RATE + 1, 1, MAX_FRAMES))
    return np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], count)))


def joint_poses(q: Array, model: RobotModel, joints: Sequence[int]) -> Array:
    """Return the poses of joints in the world, (frames, joints, 7), at q, (frames, nq).

    Quaternions (x, y, z, w) are continuous over the frames, for interpolation.
    """
    data = model.pinocchio.createData()
    poses = np.empty((len(q), len(joints), 7))
    for frame, configuration in enumerate(q):
        pin.forwardKinematics(model.pinocchio, data, np.array(configuration))
        for i, joint in enumerate(joints):
            poses[frame, i] = pin.SE3ToXYZQUAT(data.oMi[joint])
    quaternions = poses[:, :, 3:]
    dots = np.einsum("fji,fji->fj", quaternions[1:], quaternions[:-1])
    signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0), axis=0)
    quaternions[1:] *= signs[:, :, None]
    return poses


def encode_poses(poses: Array) -> dict[str, Any]:
    """Pack poses, (frames, joints, 7), as 16-bit integers: 0.1 mm over a path of 6 m."""
    low, high = poses.min(axis=(0, 1)), poses.max(axis=(0, 1))
    center, scale = (low + high) / 2.0, np.maximum((high - low) / 2.0, 1.0e-9) / _INT16
    return {
        "shape": list(poses.shape),
        "center": center.tolist(),
        "scale": scale.tolist(),
        "data": _base64(np.rint((poses - center) / scale), "<i2"),
    }


def _size(parts: Sequence[Part], pose: Array, joints: Sequence[int]) -> float:
    points = []
    for part in parts:
        placement = pin.XYZQUATToSE3(np.array(pose[joints.index(part.joint)]))
        points.append(part.vertices @ placement.rotation.T + placement.translation)
    return float(np.linalg.norm(np.ptp(np.vstack(points), axis=0))) if points else 1.0


def _corners(contact: ContactSettings, placement: pin.SE3) -> list[list[float]]:
    """Return the corners of a contact with a placement on its joint, in the joint's frame, m."""
    shape = contact.corners if isinstance(contact, SurfaceContact) else [[0.0, 0.0]]
    return [np.round(placement.act(np.array([*corner, 0.0])), 4).tolist() for corner in shape]


def _force_lines(wrench: Array, pose: Array, placement: pin.SE3) -> Array:
    """Return point of application (centre of pressure) and force of a contact in the world, (frames, 6) in m and N.

    The contact has a placement on a joint with the poses `pose`, (frames, 7), and a wrench in its frame, (frames, 6),
    or a force along the world's axes, (frames, 3).
    """
    lines = np.empty((len(wrench), 6))
    for frame, (values, where) in enumerate(zip(wrench, pose, strict=True)):
        contact = pin.XYZQUATToSE3(np.array(where)) * placement
        if len(values) == 3:
            lines[frame] = *contact.translation, *values
            continue
        pressure = np.zeros(3)
        if values[2] > 1.0:
            pressure[:2] = -values[4] / values[2], values[3] / values[2]
        lines[frame] = *contact.act(pressure), *(contact.rotation @ values[:3])
    return lines


def _base64(values: npt.ArrayLike, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")
