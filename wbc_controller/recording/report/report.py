"""The report of a demo run: one HTML file with the verdict, a replay of the motion and plots, that needs no network."""

from __future__ import annotations

import base64
import html
import importlib.resources
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from plotly.offline import get_plotlyjs

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.report.report_plots import Plot, build_plots, phases
from wbc_controller.recording.report.run_record import Recording
from wbc_controller.records import Array
from wbc_controller.controller.visualization.geometry import Part, build_parts

FRAME_RATE = 30.0
#: Largest number of frames; long runs have fewer frames per second, so that the page stays small.
MAX_FRAMES = 3600
_INT16 = 32767


def write_report(
    recording: Recording, model: RobotModel, path: Path, *, kind: str = "wbc_controller demo", note: str = ""
) -> None:
    """Write the report of a run as one self-contained HTML file.

    Args:
        recording: recording of the run.
        model: the robot of the recording.
        path: the file to write.
        kind: of the run, above the robot's name.
        note: said below the verdict.

    Raises:
        ConfigurationError: if the robot's visual geometry cannot be read, or a support names an unknown frame.
        ValueError: if the recording is of another robot.
    """
    if recording.q.shape[1] != model.nq:
        raise ValueError(f"the recording's q has {recording.q.shape[1]} columns; the model of the robot has {model.nq}")
    plots = build_plots(recording)
    pieces = {
        "title": html.escape(f"{recording.robot}: {kind}"),
        "kind": html.escape(kind),
        "robot": html.escape(recording.robot),
        "verdict": _verdict(recording) + (f"<p>{html.escape(note)}</p>" if note else ""),
        "facts": _facts(recording),
        "results": _results(recording),
        "plots": "\n".join(_figure(plot) for plot in plots),
        "replay_data": json_in_page(replay_data(recording, model, build_parts(model))),
        "plot_data": json_in_page({plot.key: json.loads(plot.figure.to_json()) for plot in plots}),
        "style": resource("report.css"),
        "plotly": get_plotlyjs(),
        "replay": resource("replay.js"),
        "page": resource("page.js"),
    }
    template = resource("report.html")
    # In one pass, so that text like a placeholder within a piece is not replaced.
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: pieces[match.group(1)], template)
    path.write_text(page, encoding="utf-8")


def replay_data(recording: Recording, model: RobotModel, parts: Sequence[Part]) -> dict[str, Any]:
    """Collect the data of the replay: bodies, their poses in each frame, contact forces and the centre of mass.

    Returns:
        The input of ``replay.js``, ready for JSON. Arrays of numbers are base64 of little-endian bytes.
    """
    frames = frame_indices(recording.time)
    time = recording.time[frames]
    contacts = [name for name in recording.contact_wrenches if name in recording.supports]
    carriers = {name: _placement_on_joint(recording, model, name) for name in contacts}
    # A robot without shapes stands for itself by its centre of mass, in the world's frame.
    joints = sorted({part.joint for part in parts} | {joint for joint, _ in carriers.values()}) or [0]
    poses = joint_poses(recording.q[frames], model, joints)
    forces = np.zeros((len(frames), len(contacts), 2, 6))
    for i, name in enumerate(contacts):
        joint, placement = carriers[name]
        pose = poses[:, joints.index(joint)]
        for j, wrenches in enumerate((recording.contact_wrenches, recording.true_wrenches)):
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
                "corners": [
                    np.round(carriers[name][1].act(corner), 4).tolist() for corner in recording.supports[name].corners
                ],
            }
            for name in contacts
        ],
        "forces": _base64(np.nan_to_num(forces), "<f4"),
        "com": _base64(np.hstack([recording.com[frames], recording.com_reference[frames]]), "<f4"),
        "weight": model.mass * model.gravity,
        "size": _size(parts, poses[0], joints),
        "phases": phases(recording),
        "modes": list(recording.modes),
    }


def frame_indices(time: Array) -> npt.NDArray[np.intp]:
    """Choose the samples for the frames of the replay, evenly over the run with both ends included."""
    count = int(np.clip((time[-1] - time[0]) * FRAME_RATE + 1, 1, MAX_FRAMES))
    return np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], count)))


def joint_poses(q: Array, model: RobotModel, joints: Sequence[int]) -> Array:
    """Compute the poses of joints in the world.

    Args:
        q: configurations, (frames, nq).
        model: the robot.
        joints: indices of joints of `RobotModel.pinocchio`.

    Returns:
        Position and quaternion (x, y, z, w) of each joint, (frames, joints, 7); along the frames a quaternion never
        jumps to its negative, so that poses can be interpolated.
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
    """Pack poses, (frames, joints, 7), as 16-bit integers: a tenth of a millimetre over a path of 6 m."""
    low, high = poses.min(axis=(0, 1)), poses.max(axis=(0, 1))
    center, scale = (low + high) / 2.0, np.maximum((high - low) / 2.0, 1.0e-9) / _INT16
    return {
        "shape": list(poses.shape),
        "center": center.tolist(),
        "scale": scale.tolist(),
        "data": _base64(np.rint((poses - center) / scale), "<i2"),
    }


def decode_poses(packed: Mapping[str, Any]) -> Array:
    """Decode the result of `encode_poses`, as ``replay.js`` does."""
    whole = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").reshape(packed["shape"])
    return np.asarray(whole * np.array(packed["scale"]) + np.array(packed["center"]))


def _size(parts: Sequence[Part], pose: Array, joints: Sequence[int]) -> float:
    """Return the diagonal of the robot's bounding box, m."""
    points = []
    for part in parts:
        placement = pin.XYZQUATToSE3(np.array(pose[joints.index(part.joint)]))
        points.append(part.vertices @ placement.rotation.T + placement.translation)
    return float(np.linalg.norm(np.ptp(np.vstack(points), axis=0))) if points else 1.0


def _placement_on_joint(recording: Recording, model: RobotModel, contact: str) -> tuple[int, pin.SE3]:
    support = recording.supports[contact]
    frame = model.pinocchio.frames[model.frame_id(support.frame, f"contacts.{contact}.frame")]
    return int(frame.parentJoint), frame.placement * pin.XYZQUATToSE3(np.array(support.placement))


def _force_lines(wrench: Array, pose: Array, placement: pin.SE3) -> Array:
    """Turn wrenches of a contact into arrows in the world.

    Args:
        wrench: wrench in the contact's frame, (frames, 6), or force along the world's axes, (frames, 3).
        pose: pose of the joint that moves the contact, (frames, 7).
        placement: placement of the contact on that joint.

    Returns:
        Point of application and force, (frames, 6) in m and N. A wrench applies at its centre of pressure.
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


def _verdict(recording: Recording) -> str:
    failed = [result.name for result in recording.results if not result.passed]
    count = len(recording.results)
    if not count:
        return '<p class="verdict">Nothing was checked in this run.</p>'
    if not failed:
        return f'<p class="verdict pass"><span class="mark"></span>All {count} targets met.</p>'
    names = html.escape(", ".join(failed))
    return f'<p class="verdict fail"><span class="mark"></span>{len(failed)} of {count} targets missed: {names}.</p>'


def _facts(recording: Recording) -> str:
    facts = [("Simulated", f"{recording.duration:.1f} s"), ("Actuators", str(len(recording.actuators)))]
    if len(recording.cycle_seconds):
        median, p99 = 1.0e3 * np.percentile(recording.cycle_seconds, [50.0, 99.0])
        facts += [("Control cycles", f"{len(recording.cycle_seconds):,}"), ("Median cycle", f"{median:.2f} ms")]
        facts += [("99th percentile", f"{p99:.2f} ms")]
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in facts)


def _results(recording: Recording) -> str:
    rows = []
    for result in recording.results:
        state, word = ("pass", "met") if result.passed else ("fail", "missed")
        name, target, measured = (html.escape(text) for text in (result.name, result.target, result.measured))
        rows.append(
            f'<tr class="{state}"><th scope="row">{name}</th><td data-label="Target">{target}</td>'
            f'<td data-label="Measured">{measured}</td><td><span class="pill {state}">{word}</span></td></tr>'
        )
    return "\n".join(rows)


def _figure(plot: Plot) -> str:
    width = "wide" if plot.over_time else "half"
    return (
        f'<figure class="card plot {width}" data-plot="{plot.key}" data-over-time="{str(plot.over_time).lower()}">'
        f"<figcaption><h2>{html.escape(plot.title)}</h2><p>{html.escape(plot.caption)}</p></figcaption>"
        '<div class="legend"></div><div class="phases" aria-hidden="true"></div>'
        f'<div class="chart" style="height:{plot.figure.layout.height}px"></div></figure>'
    )


def json_in_page(value: Any) -> str:
    """Write JSON that cannot end the script element around it."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")


def _base64(values: npt.ArrayLike, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def resource(name: str) -> str:
    """A file of the folder ``page``."""
    return (importlib.resources.files("wbc_controller.recording.report") / "page" / name).read_text(encoding="utf-8")
