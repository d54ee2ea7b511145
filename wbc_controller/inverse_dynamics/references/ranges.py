"""Ranges of references and external wrenches, from the robot's size, weight and limits.

Values outside are mistakes, such as another unit. Values inside may still be out of reach: the quadratic program then
comes as near as its constraints permit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wbc_controller.arguments import shortened
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import GazeTask, PostureTask, RelativePoseTask, Task, TorqueTask
from wbc_controller.records import Array, Reference

#: Longest duration of a setpoint or trajectory, s, and shortest time between two points.
LONGEST, SHORTEST = 86_400.0, 1.0e-4
#: Largest distance from the centre of mass, in robot sizes; of the target of a gaze.
_FAR, _FAR_GAZE = 10.0, 1.0e4
#: Largest distance beyond a joint limit, and from 0 without limits, rad or m.
_BEYOND, _TURNS = 2.0 * math.pi, 1.0e3
#: Largest force, in weights of the robot, and largest torque, in effort limits.
_STRONG = 10.0
#: Time in which a velocity covers the range of positions, and an acceleration reaches such a velocity, s.
_QUICK = 0.1
#: Largest angular velocity, rad/s; also of joints.
_SPIN = 100.0
#: Largest value of a quantity without a known unit.
_UNKNOWN = 1.0e6
_STANDARD_GRAVITY = 9.81


def check_wrench(wrench: Array, model: RobotModel, what: str) -> None:
    """Check an external wrench, (6,) in N and N·m.

    Raises:
        InputRefused: if a value is outside its range.
    """
    _require_within(wrench, 0.0, _largest_wrench(model), what, "N, N·m")


def check_references(task: Task, references: Sequence[Reference | Knot], dynamics: Dynamics) -> None:
    """Check references of a task at the present state of the robot.

    Raises:
        InputRefused: if a value is outside its range.
    """
    what, n = f"{task.full_name}: a reference", task.form.vector
    middle, reach = _range_of(task, dynamics)
    _require_within(np.array([each.position[:n] for each in references]), middle, reach, what, task.unit)
    _require_rates(task, np.array([each.velocity for each in references]), reach, 1)
    _require_rates(task, np.array([each.acceleration for each in references]), reach, 2)


def check_trajectory(task: Task, points: Sequence[Knot], dynamics: Dynamics) -> None:
    """Check the points of a trajectory, as `check_references`, and the mean velocities between them.

    Raises:
        InputRefused: if a value or a time is outside its range.
    """
    check_references(task, points, dynamics)
    times = np.array([point.time for point in points])
    gaps = np.diff(times)
    if not (times[0] >= 0.0 and times[-1] <= LONGEST and (gaps >= SHORTEST).all()):
        raise InputRefused(
            f"{task.full_name}: the times of the trajectory are {shortened(times)} s; they rise from 0 by {SHORTEST:g} "
            f"s or more, to {LONGEST:g} s at most"
        )
    vectors = np.array([point.position[: task.form.vector] for point in points])
    _require_rates(task, np.diff(vectors, axis=0) / gaps[:, None], _range_of(task, dynamics)[1], 1)


def _require_rates(task: Task, rates: Array, reach: Array | float, order: int) -> None:
    """Raise `InputRefused` if a velocity (order 1) or acceleration (order 2), (n, k), is outside its range."""
    n = task.form.vector
    largest = np.full(task.form.rate_size, _SPIN)
    if not (isinstance(task, PostureTask) or task.form.direction):
        largest[:n] = reach / _QUICK
    kind = ("velocity", "acceleration")[order - 1]
    largest = largest[: rates.shape[1]] / _QUICK ** (order - 1)
    _require_within(rates, 0.0, largest, f"{task.full_name}: a reference's {kind}", f"per s{'²' * (order - 1)}")


def _range_of(task: Task, dynamics: Dynamics) -> tuple[Array | float, Array | float]:
    """Return the middle of the range of a task's position vector, and the largest distance from it, (n,) or ()."""
    model, n = dynamics.model, task.form.vector
    far = _FAR * model.size
    if isinstance(task, PostureTask):
        indices = [model.joints.index(joint) for joint in task.joints]
        lower, upper = model.position_lower[indices], model.position_upper[indices]
        limited = np.isfinite(lower) & np.isfinite(upper)
        middle = np.where(limited, 0.5 * (lower + upper), 0.0)
        return middle, np.where(limited, 0.5 * (upper - lower) + _BEYOND, _TURNS)
    if isinstance(task, TorqueTask):
        return 0.0, _STRONG * float(np.max(model.effort_limits, initial=1.0))
    if task.unit == "N, N·m":
        return 0.0, _largest_wrench(model)[:n]
    if task.unit == "kg·m/s":
        return 0.0, model.mass * far / _QUICK
    if task.unit == "N·m·s":
        return 0.0, model.mass * model.size * far / _QUICK
    if task.form.direction or task.unit not in ("m", "rad", "m, rad"):
        return 0.0, _UNKNOWN
    if isinstance(task, RelativePoseTask):
        return 0.0, far
    return dynamics.com[:n], _FAR_GAZE * model.size if isinstance(task, GazeTask) else far


def _largest_wrench(model: RobotModel) -> Array:
    force = _STRONG * model.mass * _STANDARD_GRAVITY
    return np.repeat([force, force * model.size], 3)


def _require_within(values: Array, middle: Array | float, reach: Array | float, what: str, unit: str) -> None:
    """Raise `InputRefused` if a value differs from the middle of its range by more than its reach."""
    good = np.abs(values - middle) <= reach
    if good.all():
        return
    lower, upper = (np.broadcast_to(middle + sign * np.asarray(reach), good.shape) for sign in (-1.0, 1.0))
    place = tuple(np.argwhere(~good)[0])
    raise InputRefused(
        f"{what} is {np.broadcast_to(values, good.shape)[place]:.4g} {unit}; for this robot it is from "
        f"{lower[place]:.4g} to {upper[place]:.4g}"
    )
