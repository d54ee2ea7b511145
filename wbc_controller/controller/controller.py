"""Controller of one robot for Python users."""

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.arguments import finite, number, shortened, sized, str_of, unit_quaternion
from wbc_controller.controller.check.preflight import stance
from wbc_controller.controller.cycle import ControlCycle, seconds
from wbc_controller.controller.report import CycleInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.errors import ConfigurationError, InputRefused, require_known, valid_choices
from wbc_controller.inverse_dynamics.references import changes
from wbc_controller.inverse_dynamics.references.ranges import LONGEST, check_change, check_rates
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import REQUESTS, Array, Fault, Reference, RobotState, frozen
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.settings.nesting import nested

_LATEST, _LARGEST = 1.0e10, 1.0e9  # latest time of the user's clock, s, and largest value of a state, SI units


class Controller(ControlCycle):
    """Whole-body controller: computes torques from states.

    ::

        controller = Controller(load("g1"))
        controller.reset(q, v)
        while True:
            result = controller.step(q, v, t)     # result.tau: torques

    The supervisor limits torques, and damps the robot on faults (docs/safety.md). `state_from_joints` and
    `MujocoInterface` make states (`wbc_controller.records`).
    """

    _time: float | None = None  # time of the last step or reset

    def reset(self, q: npt.ArrayLike, v: npt.ArrayLike, t: float = 0.0) -> None:
        """Activate the controller at a state q (nq,), v (nv,), with any time t, s.

        References start there, and torques ramp up from zero in ``safety.activation_ramp``. Faults and commands are
        cleared, changes by `update` are kept. An invalid state raises `InputRefused`.
        """
        state = self._state(q, v, t)
        problem = self._invalid(state)
        if problem is not None:
            raise InputRefused(problem)
        self._time = seconds(state)
        self.qp.forget()
        self._commands, self._streamed = [], {}
        self._explanation.restart()
        self.supervisor = Supervisor(self.model, self.supervisor.limits)
        self._start(state)
        self.supervisor.request("activate", self._time, None)

    def stance(self) -> Array:
        """Return the nominal posture with upright base and the lowest contact on the floor z = 0, q (nq,)."""
        contacts = self.board.contact_plans.items()
        return stance(self.model, self.qp, [name for name, contact in contacts if contact.enabled])

    def step(self, q: npt.ArrayLike, v: npt.ArrayLike, t: float) -> CycleResult:
        """Run one control cycle at time t, s. A state with NaN or without a unit quaternion leads to damping.

        A state of another shape, a decreasing time, or a missing `reset` raises `InputRefused`.
        """
        state = self._state(q, v, t)
        if seconds(state) < self._now():
            raise InputRefused(f"t = {t!r} s is before the last step at {self._now():.9g} s")
        invalid = self._invalid(state)
        problem = None if invalid is None else Fault("BAD_STATE", invalid)
        self._time = seconds(state)
        commands, self._commands = self._commands, []
        result = self.cycle(
            CycleInputs(
                now=self._time,
                state=state,
                joint_velocity=state.v[self.model.v_places],
                problem=problem,
                changes=tuple((change,) for change in commands),
            )
        )
        self.explain_failure(self._time)
        return result

    def set(
        self,
        task: str,
        position: Any,
        velocity: npt.ArrayLike | None = None,
        acceleration: npt.ArrayLike | None = None,
        *,
        duration: float | None = None,
    ) -> None:
        """Set the reference of a task.

        A position alone is reached along a quintic. With a velocity or acceleration the reference is streamed: it
        applies to the next step; later steps stay at the position.

        Args:
            position: in the form of the task (docs/tasks.md); joint tasks accept a dictionary of some joints, pose
                tasks a `pinocchio.SE3`.
            velocity, acceleration: feed-forward, one value per axis of the task; world axes, linear part first.
            duration: time to reach the position, s; by default the task's ``setpoint_duration``.

        Raises:
            InputRefused: if the task is unknown or a value is invalid.
        """
        values = self._position(task, position, f"the position of task {task!r}")
        streamed = velocity is not None or acceleration is not None
        if duration is not None:
            duration = number(duration, f"the duration of task {task!r}", 0.0, LONGEST)
        if duration is not None and streamed:
            raise InputRefused(f"duration = {duration!r} s of task {task!r}: not valid with velocity or acceleration")
        if not streamed:
            self._command(changes.SetSetpoint(task, values, duration))
            return
        size = len(self.board.present(task, self._now()).velocity)
        rates = [
            _finite(given, size, f"the {subject} of task {task!r}")
            for subject, given in (("velocity", velocity), ("acceleration", acceleration))
        ]
        reference = Reference(frozen(values), *map(frozen, rates))
        check_rates(self.qp.tasks[task], self.model, reference.velocity, reference.acceleration)
        self._command(changes.SetSetpoint(task, values, 0.0))
        self._streamed[task] = reference

    def follow(
        self,
        task: str,
        times: npt.ArrayLike,
        positions: Any,
        velocities: npt.ArrayLike | None = None,
        accelerations: npt.ArrayLike | None = None,
    ) -> None:
        """Set a trajectory of a task, interpolated by quintics; the reference stays at its end.

        Args:
            times: increasing, from now, (n,) in s.
            positions: n positions, each as in `set`; errors as there.
            velocities, accelerations: at the points, (n, m); by default zero.
        """
        self._task(task)
        seconds = finite(times, f"times of task {task!r}")
        if seconds.ndim != 1 or not len(seconds) or not (seconds[0] >= 0.0) or not (np.diff(seconds) > 0.0).all():
            raise InputRefused(f"times of task {task!r} must increase from at least 0, not {np.asarray(times)!r}")
        points = [self._position(task, each, f"a position of task {task!r}") for each in _rows(positions, seconds)]
        size, still = len(self.board.present(task, self._now()).velocity), [None] * len(seconds)
        rates = [
            [
                _finite(each, size, f"{what} of task {task!r}")
                for each in _rows(still if rows is None else rows, seconds)
            ]
            for what, rows in (("a velocity", velocities), ("an acceleration", accelerations))
        ]
        knots = tuple(Knot(*each) for each in zip(seconds.tolist(), points, *rates, strict=True))
        self._command(changes.SetTrajectory(task, None, knots))

    def enable(self, name: str, enabled: bool = True) -> None:
        """Enable or disable a task or contact along a ramp of its weight or load.

        Ambiguous names are prefixed: ``tasks.<name>``, ``contacts.<name>``. An unknown or ambiguous name raises
        `InputRefused`.
        """
        if not isinstance(enabled, bool | np.bool_):
            raise InputRefused(f"enabled = {reprlib.repr(enabled)}: must be True or False")
        section, _, inner = str_of(name).rpartition(".")
        known: dict[str, Mapping[str, Any]] = {"tasks": self.board.plans, "contacts": self.board.contact_plans}
        found = [key for key, names in known.items() if inner in names and section in ("", key)]
        if not found:
            names = [*self.board.plans, *self.board.contact_plans]
            raise InputRefused(f"unknown task or contact {reprlib.repr(name)}; {valid_choices(str_of(name), names)}")
        if len(found) > 1:
            raise InputRefused(f"{name!r} is a task and a contact; use tasks.{name} or contacts.{name}")
        change = changes.EnableTask if found[0] == "tasks" else changes.EnableContact
        self._command(change(inner, bool(enabled)))

    def disable(self, name: str) -> None:
        """Disable a task or contact along a ramp, as `enable`."""
        self.enable(name, False)

    def set_weight(self, task: str, weight: float) -> None:
        """Set a task's weight, 0 to 1e6, along a ramp of ``control.weight_ramp``; others raise `InputRefused`."""
        self._task(task)
        self._command(changes.SetWeight(task, number(weight, f"the weight of task {task!r}", 0.0, 1.0e6)))

    def set_external_wrench(self, frame: str, wrench: npt.ArrayLike) -> None:
        """Set a known external wrench, (6,) in N and N·m, world axes, at the origin of a URDF frame.

        An unknown frame or an invalid value raises `InputRefused`.
        """
        try:
            self.model.frame_id(str_of(frame), "frame")
        except ConfigurationError as error:
            raise InputRefused(str(error)) from error
        self._command(changes.SetExternalWrench(frame, frozen(finite(sized(wrench, 6, "the wrench"), "the wrench"))))

    def walk(self, forward: float = 0.0, sideways: float = 0.0, turning: float = 0.0) -> None:
        """Walk at a velocity in the axes of the robot's heading, m/s and rad/s, until `stand`; 0 is in place.

        The section ``walking`` limits speeds and accelerations. Without it, or with a value that is not finite, the
        call raises `InputRefused`.
        """
        self._command_walker(changes.Walk(frozen(finite([forward, sideways, turning], "the walking velocity"))))

    def walk_to(self, x: float, y: float, heading: float) -> None:
        """Walk to a pose in the world, m and rad, and stop there; errors as for `walk`."""
        self._command_walker(changes.WalkTo(frozen(finite([x, y, heading], "the goal"))))

    def walk_footsteps(self, poses: npt.ArrayLike) -> None:
        """Step on poses of alternating soles (x, y in m and heading in rad in the world), (n, 3), and stop.

        A standing robot begins with the foot nearer to its pose. The next cycle refuses steps out of reach.
        Errors as for `walk`.
        """
        values = np.atleast_2d(finite(poses, "the footsteps"))
        if values.ndim != 2 or values.shape[1] != 3 or not len(values):
            raise InputRefused(f"the footsteps have the shape {values.shape}; it must be (n, 3)")
        self._command_walker(changes.WalkFootsteps(frozen(values)))

    def stand(self) -> None:
        """Stop walking after the step that brings the feet side by side."""
        self._command(changes.Walk(None))

    def _command_walker(self, change: changes.WalkingChange) -> None:
        if self.walker is None:
            raise InputRefused(f"{self.model.name} cannot walk: its configuration has no section 'walking'")
        self._command(change)

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change live settings (docs/configuration.md) by dotted key, such as ``{"tasks.com.stiffness": 200.0}``.

        All or none are applied, along a ramp. `reset` keeps them. An invalid value, or a key that is not live, raises
        `ConfigurationError`.
        """
        self.live.accept(nested(changes), "update")
        self._apply_live_settings(self._time)

    def request(self, word: str) -> None:
        """Request a mode: ``deactivate`` (torques ramp down), ``damp``, or ``estop`` (zero torque at once).

        A request that is unknown, or invalid in the present mode, raises `InputRefused`.
        """
        if not isinstance(word, str):
            raise InputRefused(f"command {reprlib.repr(word)} is not a string; {valid_choices('', REQUESTS)}")
        if word == "activate":
            raise InputRefused("command 'activate' requires a state; call reset(q, v, t)")
        self._request(word, self._now(), None)

    def __repr__(self) -> str:
        model = self.model
        return (
            f"<Controller of {model.name}: {model.nj} joints, {len(self.qp.tasks)} tasks, {len(self.qp.contacts)} "
            f"contacts, {1.0 / self.period:g} Hz, {self.mode.value}>"
        )

    def _state(self, q: npt.ArrayLike, v: npt.ArrayLike, t: float) -> RobotState:
        stamp = round(1.0e9 * number(t, "t", -_LATEST, _LATEST))
        return RobotState(stamp, frozen(sized(q, self.model.nq, "q")), frozen(sized(v, self.model.nv, "v")))

    def _invalid(self, state: RobotState) -> str | None:
        """Return a sentence for NaN, too large values or no unit quaternion, else None."""
        for name, values in (("q", state.q), ("v", state.v)):
            if not (np.abs(values) <= _LARGEST).all():
                kind = "not finite" if not np.isfinite(values).all() else f"above {_LARGEST:g}"
                return f"{name} is {kind}: {shortened(values)}"
        try:
            if self.model.floating_base:
                unit_quaternion(state.q[3:7], "the quaternion of q ")
        except InputRefused as refusal:
            return str(refusal)
        return None

    def _now(self) -> float:
        if self._time is None:
            raise InputRefused("the controller has no state; call reset(q, v, t) first")
        return self._time

    def _command(self, change: changes.Change) -> None:
        check_change(change, self.qp.tasks, self.model)
        self.board.check(change, self.qp.dynamics, self._now())
        self._commands.append(change)
        if isinstance(change, changes.SetSetpoint | changes.SetTrajectory):
            self._streamed.pop(change.task, None)

    def _position(self, task: str, position: Any, subject: str) -> Array:
        form = self._task(task).form
        if isinstance(position, Mapping):
            position = self._joint_positions(task, position)
        elif isinstance(position, pin.SE3):
            position = pin.SE3ToXYZQUAT(position)
        return form.position(position, subject)

    def _task(self, name: str) -> Task:
        require_known((name,), self.qp.tasks, "unknown task", error=InputRefused)
        return self.qp.tasks[name]

    def _joint_positions(self, task: str, given: Mapping[str, float]) -> Array:
        joints: tuple[str, ...] | None = getattr(self.qp.tasks[task], "joints", None)
        if joints is None:
            raise InputRefused(f"task {task!r} has no joints; its position must be an array")
        require_known(given, joints, "position:", f" is not a joint of task {task!r}", InputRefused)
        present = self.board.present(task, self._now()).position
        for change in self._commands:
            if isinstance(change, changes.SetSetpoint) and change.task == task:
                present = change.position
        values = zip(joints, present.tolist(), strict=True)
        return np.array([number(given.get(name, value), f"the position of {name!r}") for name, value in values])


def _finite(values: npt.ArrayLike | None, size: int, subject: str) -> Array:
    return finite(sized(np.zeros(size) if values is None else values, size, subject), subject)


def _rows(values: Any, times: Array) -> Sequence[Any]:
    if isinstance(values, np.ma.MaskedArray) or not isinstance(values, Sequence | np.ndarray):
        raise InputRefused(f"points = {reprlib.repr(values)}: must be a list with one entry per time")
    rows = [] if isinstance(values, np.ndarray) and values.ndim == 0 else list(values)
    if len(rows) != len(times):
        raise InputRefused(f"{len(rows)} points for {len(times)} times; expected one per time")
    return rows
