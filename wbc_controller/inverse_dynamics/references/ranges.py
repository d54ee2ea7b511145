"""Plausible ranges of references and external wrenches.

Values in range may still be unreachable.
"""

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.arguments import shortened
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change, SetExternalWrench, SetTrajectory
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import GazeTask, PostureTask, RelativePoseTask, Task, TorqueTask
from wbc_controller.records import Array

#: Longest duration of a setpoint or trajectory, and shortest time between points, s.
LONGEST, SHORTEST = 86_400.0, 1.0e-4
#: Largest distance from the centre of mass, and of a gaze target, in robot sizes; trajectory points may move as far per
#: second.
_LARGEST_DISTANCE, _LARGEST_GAZE_DISTANCE = 10.0, 1.0e4
#: Largest distance beyond a joint limit, and from 0 without limits, rad or m.
_LARGEST_OVERSHOOT, _LARGEST_UNLIMITED = 2.0 * math.pi, 1.0e3
_LARGEST_EFFORT = 10.0  # force in weights of the robot, torque in effort limits
_SHORTEST_TIME = 0.1  # through the range of positions, and to such a velocity, s
_LARGEST_ANGULAR_VELOCITY = 100.0  # rad/s
_LARGEST_UNKNOWN = 1.0e6  # without a known unit
_STANDARD_GRAVITY = 9.81


#: Middle of the range of a task's position vector, (n,) or one number, None for the centre of mass; reach from there.
PositionRange = tuple[Array | float | None, Array | float]


def check_position(task: Task, position: Array, allowed: PositionRange, dynamics: Dynamics) -> None:
    """Check a position at the present state; raises `InputRefused`."""
    n, (middle, reach) = task.form.vector, allowed
    middle = dynamics.com[:n] if middle is None else middle
    _require_within(position[:n], middle, reach, f"{task.full_name}: a reference", task.unit)


def check_change(change: Change, tasks: Mapping[str, Task], model: RobotModel) -> None:
    """Check external wrenches and trajectory points; raises `InputRefused`."""
    if isinstance(change, SetExternalWrench):
        what = f"the external wrench at {change.frame!r}"
        _require_within(change.wrench, np.zeros(6), _largest_wrench(model), what, "N, N·m")
    if not isinstance(change, SetTrajectory):
        return
    task, points = tasks[change.task], change.points
    n = task.form.vector
    times = np.array([point.time for point in points])
    gaps = np.diff(times)
    if not (times[0] >= 0.0 and times[-1] <= LONGEST and (gaps >= SHORTEST).all()):
        raise InputRefused(
            f"{task.full_name}: the times of the trajectory are {shortened(times)} s; they must increase from 0 by "
            f"{SHORTEST:g} s or more, to {LONGEST:g} s at most"
        )
    vectors = np.array([point.position[:n] for point in points])
    middle, reach = position_range(task, model)
    if middle is None:  # a walking robot moves far
        middle, reach = vectors[0], reach * (1.0 + times - times[0])[:, None]
    _require_within(vectors, middle, reach, f"{task.full_name}: a reference", task.unit)
    velocities, accelerations = (np.array([getattr(p, name) for p in points]) for name in ("velocity", "acceleration"))
    check_rates(task, model, velocities, accelerations)
    check_rates(task, model, np.diff(vectors, axis=0) / gaps[:, None])


def check_rates(task: Task, model: RobotModel, *rates: Array) -> None:
    """Check velocity and acceleration of a reference; raises `InputRefused`."""
    largest = np.full(task.form.rate_size, _LARGEST_ANGULAR_VELOCITY)
    if not (isinstance(task, PostureTask) or task.form.direction):
        largest[: task.form.vector] = position_range(task, model)[1] / _SHORTEST_TIME
    for order, (name, values) in enumerate(zip(("velocity", "acceleration"), rates, strict=False)):
        what, bound = f"{task.full_name}: a reference's {name}", largest[: values.shape[-1]] / _SHORTEST_TIME**order
        _require_within(values, np.zeros(len(bound)), bound, what, f"per s{'²' * order}")


def position_range(task: Task, model: RobotModel) -> PositionRange:
    """Return the range of a task's references."""
    far = _LARGEST_DISTANCE * model.size
    if isinstance(task, PostureTask):
        indices = [model.joints.index(joint) for joint in task.joints]
        lower, upper = model.position_lower[indices], model.position_upper[indices]
        limited = np.isfinite(lower) & np.isfinite(upper)
        middle = np.where(limited, 0.5 * (lower + upper), 0.0)
        return middle, np.where(limited, 0.5 * (upper - lower) + _LARGEST_OVERSHOOT, _LARGEST_UNLIMITED)
    if isinstance(task, TorqueTask):
        return 0.0, _LARGEST_EFFORT * float(np.max(model.effort_limits, initial=1.0))
    if task.unit == "N, N·m":
        return 0.0, _largest_wrench(model)
    if task.unit == "kg·m/s":
        return 0.0, model.mass * far / _SHORTEST_TIME
    if task.unit == "N·m·s":
        return 0.0, model.mass * model.size * far / _SHORTEST_TIME
    if task.form.direction or task.unit not in ("m", "rad", "m, rad"):
        return 0.0, _LARGEST_UNKNOWN
    if isinstance(task, RelativePoseTask):
        return 0.0, far
    return None, _LARGEST_GAZE_DISTANCE * model.size if isinstance(task, GazeTask) else far


def _largest_wrench(model: RobotModel) -> Array:
    force = _LARGEST_EFFORT * model.mass * _STANDARD_GRAVITY
    return np.repeat([force, force * model.size], 3)


def _require_within(values: Array, middle: Array | float, reach: Array | float, what: str, unit: str) -> None:
    good = np.abs(values - middle) <= reach
    if good.all():
        return
    place = tuple(np.argwhere(~good)[0])
    value, centre, distance = (np.broadcast_to(each, good.shape)[place] for each in (values, middle, reach))
    raise InputRefused(
        f"{what} is {value:.4g} {unit}; for this robot it must be from {centre - distance:.4g} to "
        f"{centre + distance:.4g}"
    )
