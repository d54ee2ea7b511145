"""Grips, closed loops and the hoist of the mock robot."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.contacts import contact_placement, make_loop_closure
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.contacts import placement_of
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings, FixedContact, LoopSettings
from wbc_controller.simulation.shapes import wxyz

_HOIST = "hoist"
STIFF_STEPS = 4.0  # time constant of contacts, joint stops and hoist, in simulation steps, at least two
IMPEDANCE = 0.98  # MuJoCo's impedance; below 1, redundant contacts are well posed
RAMP = 0.3  # duration of engaging or releasing the hoist, s
SPEED, TURN = 0.5, 1.0  # speeds of the return to the start, m/s and rad/s
HINGE_LENGTH = 0.1  # distance between the two points of a hinge, m
_TORQUE_SCALE = 1.0  # torque scale of welds, m: equal stiffness of rotation and translation
_REDUNDANT = 1.0e-6  # largest part of a redundant row outside the span of other rows


@dataclass(frozen=True, slots=True)
class Attachment:
    """Attachment of a link to another link, or to the world."""

    names: tuple[str, ...]  # of equality constraints: one weld, or one or two points
    points: Array | None  # in the attached frame, (n, 3) in m; None for a weld
    joints: tuple[int, int]  # Pinocchio joints of holder and held link; 0 for the world
    placements: tuple[pin.SE3, pin.SE3]  # of the attached frame: target on the holder, and on the link


def points_of(mask: Sequence[bool], key: str) -> Array | None:
    """Return the points of a frame that hold the axes of a mask; None for all six axes."""
    turns = [int(axis) for axis in np.flatnonzero(mask[3:])]
    if all(mask):
        return None
    if all(mask[:3]) and not turns:
        return np.zeros((1, 3))
    if all(mask[:3]) and len(turns) == 2:
        free = ({0, 1, 2} - set(turns)).pop()
        return np.vstack([np.zeros(3), HINGE_LENGTH * np.eye(3)[free]])
    raise ConfigurationError(
        f"{key} = {list(mask)}: not supported by the mock robot; valid: all six axes, three translations, or three "
        "translations and two rotations"
    )


def grips_of(model: RobotModel, contacts: Mapping[str, ContactSettings]) -> dict[str, Attachment]:
    """Return the grips of fixed contacts by name."""
    grips = {}
    for name, contact in contacts.items():
        if not isinstance(contact, FixedContact):
            continue
        points = points_of(contact.mask, f"contacts.{name}.mask")
        holder = 0 if contact.against is None else frame_on_joint(model, contact.against)[0]
        joint, placement = contact_placement(model, name, contact)
        names = tuple(f"{name}/grip/{index}" for index in range(1 if points is None else len(points)))
        grips[name] = Attachment(names, points, (holder, joint), (pin.SE3.Identity(), placement))
    return grips


def closures_of(model: RobotModel, loops: Mapping[str, LoopSettings]) -> dict[str, Attachment]:
    """Return the joints that close loops by name; frame_b is held in frame_a."""
    closures = {}
    for name, loop in loops.items():
        points = points_of(_effective_mask(model, name, loop), f"loops.{name}.mask")
        (a, frame_a), (b, frame_b) = frame_on_joint(model, loop.frame_a), frame_on_joint(model, loop.frame_b)
        placements = (
            frame_a * placement_of(loop.translation_a, loop.rpy_a),
            frame_b * placement_of(loop.translation_b, loop.rpy_b),
        )
        names = tuple(f"{name}/loop/{index}" for index in range(1 if points is None else len(points)))
        closures[name] = Attachment(names, points, (a, b), placements)
    return closures


def frame_on_joint(model: RobotModel, name: str) -> tuple[int, pin.SE3]:
    """Return the Pinocchio joint of a robot frame, and the frame's placement on it."""
    return placement_on_link(model, model.frame_id(name, "frame"))


def _effective_mask(model: RobotModel, name: str, loop: LoopSettings) -> list[bool]:
    """Add the axes along which a loop cannot move anyway, such as out of a planar loop."""
    whole = make_loop_closure(name, loop.model_copy(update={"mask": [True] * 6}), model)
    dynamics = Dynamics(model)
    # Leave the nominal posture, which may be singular.
    step = 0.3 * np.cos(np.arange(model.nv))
    dynamics.update(pin.integrate(model.pinocchio, dynamics.q, step), np.zeros(model.nv))
    J = whole.jacobian(dynamics)
    _, values, rows = np.linalg.svd(J[loop.mask])
    span = rows[: int(np.sum(values > _REDUNDANT))]
    return [bool(np.linalg.norm(row - span.T @ (span @ row)) < _REDUNDANT) for row in J]


def attach(spec: Any, attachment: Attachment, bodies: tuple[str, str]) -> None:
    """Add the constraints of an attachment to a MuJoCo specification, without placement."""
    kind = mujoco.mjtEq.mjEQ_WELD if attachment.points is None else mujoco.mjtEq.mjEQ_CONNECT
    for constraint in attachment.names:
        _add_equality(spec, constraint, kind, bodies)


def add_hoist(spec: Any, root: str) -> None:
    """Add the weld of the hoist to the root link; its placement is set at run time."""
    _add_equality(spec, _HOIST, mujoco.mjtEq.mjEQ_WELD, ("world", root))


def _add_equality(spec: Any, name: str, kind: Any, bodies: tuple[str, str]) -> None:
    """Add a weld or a connection at the origins of two bodies to a MuJoCo specification."""
    body = mujoco.mjtObj.mjOBJ_BODY
    equality = spec.add_equality(name=name, type=kind, objtype=body, name1=bodies[0], name2=bodies[1])
    equality.data[:11] = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, _TORQUE_SCALE]


def place(model: Any, attachment: Attachment, holder: pin.SE3) -> None:
    """Set the target placement of an attachment in the holder's frame."""
    link = attachment.placements[1]
    for index, constraint in enumerate(attachment.names):
        data = model.eq_data[model.equality(constraint).id]
        if attachment.points is None:
            # Point in the second and first body, then the second body's orientation in the first.
            data[:3], data[3:6] = link.translation, holder.translation
            data[6:10] = wxyz((holder * link.inverse()).rotation)
        else:
            data[:3] = holder.act(attachment.points[index])
            data[3:6] = link.act(attachment.points[index])


def wrench(model: Any, data: Any, attachment: Attachment) -> Array:
    """Return the wrench on the link about the attached frame's origin, world axes, (6,)."""
    body = int(model.eq_obj2id[model.equality(attachment.names[0]).id])
    link = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])
    origin = link.act(attachment.placements[1].translation)
    total = np.zeros(6)
    equality = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    for index, constraint in enumerate(attachment.names):
        rows = np.flatnonzero(equality & (data.efc_id[: data.nefc] == model.equality(constraint).id))
        if not len(rows):
            continue
        force = -data.efc_force[rows]  # MuJoCo: first body minus second
        total[:3] += force[:3]
        if attachment.points is None:
            # Rotation rows are half the relative angular velocity in the second body's axes.
            total[3:] += 0.5 * _TORQUE_SCALE * link.rotation @ force[3:]
        else:
            arm = link.act(attachment.placements[1].act(attachment.points[index])) - origin
            total[3:] += cross(arm, force[:3])
    return total


class Hoist:
    """Weld between world and base with ramps of strength and placement; `start` is the held placement."""

    def __init__(self, model: Any, data: Any, start: pin.SE3) -> None:
        self.start = start
        self._model = model
        self._data = data
        self._id = model.equality(_HOIST).id
        self._step = float(model.opt.timestep)
        self._strength, self._rate = 1.0, 0.0
        self._from, self._progress, self._progress_rate = start, 1.0, 0.0
        self._write()

    @property
    def held(self) -> bool:
        """True if the base is held, or the hoist is being engaged."""
        return self._rate > 0.0 or (self._rate == 0.0 and self._strength == 1.0)

    def hold(self, held: bool, base: pin.SE3, ramp: float) -> None:
        """Hold the base within `ramp`, s, and move it from its placement to the start, or release it."""
        if held:
            self._from, self._progress = base, 0.0
            way = pin.log6(base.actInv(self.start)).vector
            seconds = max(np.linalg.norm(way[:3]) / SPEED, np.linalg.norm(way[3:]) / TURN)
            self._progress_rate = 1.0 / max(1, math.ceil(seconds / self._step))
        rate = self._step / ramp if ramp > 0.0 else 1.0
        self._rate = rate if held else -rate
        if not ramp > 0.0:
            self.advance()

    def advance(self) -> None:
        """Advance the ramps by one step."""
        if self._rate == 0.0 and self._progress == 1.0:
            return
        self._strength = min(1.0, max(0.0, self._strength + self._rate))
        self._progress = min(1.0, self._progress + self._progress_rate)
        if self._strength in (0.0, 1.0):
            self._rate = 0.0
        self._write()

    def _write(self) -> None:
        target = pin.SE3.Interpolate(self._from, self.start, self._progress)
        self._model.eq_data[self._id, 3:10] = [*target.translation, *wxyz(target.rotation)]
        # The impedance d blends free and spring acceleration, (1 - d) a_free + d (-k r - b dr/dt), without a jerk at
        # release. MuJoCo divides k and b by d, which is undone here.
        d = IMPEDANCE * self._strength
        time_constant = STIFF_STEPS * self._step
        self._model.eq_solref[self._id] = -d / time_constant**2, -2.0 * d / time_constant
        self._model.eq_solimp[self._id, :2] = d
        self._data.eq_active[self._id] = self._strength > 0.0
