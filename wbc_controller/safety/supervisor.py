"""The supervisor: the modes of the controller, and the only maker of a `JointCommand`.

::

    inactive ── activate ──> active <──> holding        no solution: last torques plus damping, for `hold_time` in all
       ^ ^ <── deactivate ──   │            │
       │                       v            v
     reset               damping ──────────────> fault (or stopped, where a user asked for it)
       └─────────────── from damping, stopped and fault

From every mode `estop` leads to fault, and the end of the process to stopped; both set the torques to zero at once.

In inactive nothing is published once the torques are zero. Damping opposes the joint velocities; where these are not
known, the torques ramp to zero. In stopped and fault zero torques are published. A fault is latched until `reset`.
"""

import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import InputRefused, NoSolution, valid_choices
from wbc_controller.inverse_dynamics.arrays import all_finite, all_true
from wbc_controller.inverse_dynamics.limits.torque import TorqueSpeedCurve
from wbc_controller.inverse_dynamics.references.trajectories import Ramp
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import REQUESTS, Array, Fault, JointCommand, Mode, RobotState, Solution, freeze, frozen
from wbc_controller.safety.checks import (
    TORQUE_TOLERANCE,
    no_solution_for_too_long,
    relaxed_for_too_long,
    unusable_torques,
)
from wbc_controller.safety.damping import damping_matrix, stable_damping
from wbc_controller.safety.plausibility import Budget, FallLimits, FallWatch, PlausibilityLimits, StateWatch
from wbc_controller.safety.supervisor_kernels import CommandLimits, follow

_ACTIVE, _HOLDING = Mode.ACTIVE, Mode.HOLDING
#: Time within which a joint would reach its position limit that is held without its torque, s.
_AHEAD = 0.05


@dataclass(frozen=True, slots=True)
class SupervisorLimits:
    """Timing and limits of the supervisor."""

    activation_ramp: float  # time in which the torques ramp in, s
    hold_time: float  # longest time without a solution within `hold_window` before damping, s
    damping_time: float  # time of damping before zero torque, s
    damping: float
    torque_rate: float  # torque rate limit, in effort limits per second
    period: float
    # torque-speed curve of the motors; None for their effort limits at every speed
    torque_speed: TorqueSpeedCurve | None = None
    # window over which the time without a solution adds up, s; 0 counts only without interruption
    hold_window: float = 0.0
    relax_time: float = math.inf  # longest time with relaxed constraints within `relax_window` before damping, s
    relax_window: float = 0.0  # window over which that time adds up, s
    plausibility: PlausibilityLimits | None = None  # limits of plausible states; None checks nothing
    fall: FallLimits | None = None  # limits beyond which the robot has fallen; None checks nothing
    velocity_delay: float = 0.0  # by how much the joint velocities are late, s; damping bears it
    # time constant with which the torques sent follow those of the solutions, s; 0 for at once
    torque_filter: float = 0.0


class Supervisor:
    """Decides in every cycle which command goes to the joints.

    Attributes:
        fault: why the active mode was left; latched until `reset`.
        limits: timing and limits; may be replaced between cycles.
    """

    #: What outlives a cycle, beside the limits.
    STATE_FIELDS = (
        "mode", "fault", "_since", "_stepped", "_activated", "_held_time", "_relaxed_time", "_relaxed", "_was_relaxed",
        "_share", "_tau", "_held", "_taken_over", "_watch", "_fall",
    )  # fmt: skip

    def __init__(self, model: RobotModel, limits: SupervisorLimits) -> None:
        self.mode = Mode.INACTIVE
        self.fault: Fault | None = None
        self._model = model
        self._effort_limits = (-model.effort_limits, model.effort_limits)
        self._torques_available = np.array(self._effort_limits)
        self._limits: SupervisorLimits | None = None
        self.limits = limits
        self._since = 0.0  # when the present mode began, s
        self._stepped = -math.inf  # when the last step was, s
        self._activated = -math.inf  # when the last activation was, s
        self._held_time, self._relaxed_time = Budget(), Budget()
        self._relaxed: dict[str, None] = {}  # what was relaxed within the window
        self._was_relaxed = False  # whether the last solution was
        self._share = Ramp(0.0, 0.0, 0.0, 0.0)  # share of the solution's torques that is sent: ramps in and out
        self._no_torque = frozen(np.zeros(model.na))
        self._tau = self._no_torque  # last torques sent
        self._held = self._no_torque  # the torques at the start of holding
        self._taken_over = False  # whether the torques have reached the solution's since activation
        self._no_state = RobotState(0, frozen(np.full(model.nq, np.nan)), frozen(np.full(model.nv, np.nan)))
        na, nj = model.na, model.nj
        self._parts = slice(0, na), slice(na, na + nj), slice(na + nj, na + 2 * nj)  # of a command
        self._nowhere = frozen(np.full(model.nj, np.nan))

    @property
    def limits(self) -> SupervisorLimits:
        """Timing and limits; may be replaced between cycles."""
        return self._limits  # type: ignore[return-value]  # set by the constructor

    @limits.setter
    def limits(self, limits: SupervisorLimits) -> None:
        old, self._limits = self._limits, limits
        self._period = self._passed = limits.period  # what passes until a command, s
        self._rate = limits.torque_rate * self._model.effort_limits  # N·m/s
        self._filter = limits.torque_filter
        self._curve = limits.torque_speed
        # What takes time, or remembers, is made anew only where its own limits are other ones.
        if old is None or (old.damping, old.period) != (limits.damping, limits.period):  # a delay is for good
            D = stable_damping(self._model, limits.damping, limits.period + limits.velocity_delay)
            self._damping_matrix = damping_matrix(self._model.actuation, D)  # (na, nj)
        if old is None or old.plausibility != limits.plausibility:
            self._watch = StateWatch(self._model, limits.plausibility) if limits.plausibility is not None else None
        if old is None or old.fall != limits.fall:
            self._fall = FallWatch(self._model, limits.fall) if limits.fall is not None else None
        self._command_limits = CommandLimits(
            limits=self._model.effort_limits,
            rate=self._rate,
            available=self._torques_available,
            tolerance=TORQUE_TOLERANCE,
            q_index=self._model.q_index,
            v_index=self._model.v_index,
            period=self._period,
        )

    @property
    def solving(self) -> bool:
        """Whether this cycle needs a solution."""
        return self.mode is Mode.ACTIVE or self.mode is Mode.HOLDING

    def torques_before(self, now: float) -> Array | None:
        """The present torques, for the torque rate limit of the program; None while they ramp in or out.

        It stays None after a short ramp until the torques sent are within one rate step of the solution's.
        """
        if self.mode is _ACTIVE and self._taken_over and self._share.sample(now) >= 1.0:
            return self._tau
        return None

    def request(self, word: str, now: float, problem: Fault | None) -> bool:
        """Take a user's request, one of `REQUESTS`, at a time, s; `problem` is the fault of the inputs, if any.

        Returns:
            Whether this activates the controller, which then has to start from the present state.

        Raises:
            InputRefused: where the request is unknown, or not possible now.
        """
        if word not in REQUESTS:
            raise InputRefused(f"command {word!r} is unknown; {valid_choices(word, REQUESTS)}")
        if word == "estop":
            self._enter(Mode.FAULT, now, Fault("ESTOP", "emergency stop by command"))
            self._tau = self._no_torque  # at once, without a rate
        elif word == "reset":
            self._reset(now)
        elif word == "activate":
            return self._activate(now, problem)
        elif self.mode is Mode.INACTIVE:
            raise InputRefused(f"command {word!r} has no effect: the controller is inactive")
        elif not self.solving:
            raise InputRefused(f"command {word!r} has no effect: the controller is {self.mode.value}; use 'reset'")
        elif word == "damp":
            self._enter(Mode.DAMPING, now, self.fault)
        elif self._share.after > 0.0:
            self._share = self._share.towards(0.0, now, self.limits.activation_ramp)
        return False

    def explain(self, failure: NoSolution) -> None:
        """Add the conflicting constraints to the present fault, if its code is ``NO_SOLUTION``."""
        if self.fault is not None and self.fault.code == "NO_SOLUTION":
            self.fault = Fault("NO_SOLUTION", str(failure), failure.infeasibility)

    def shut_down(self, now: float) -> JointCommand | None:
        """Make a last command with zero torques when the process ends; None where nothing was being sent."""
        if self.mode is Mode.INACTIVE and not self._tau.any():
            return None
        self._enter(Mode.STOPPED, now, self.fault)
        self._tau = self._no_torque  # at once: there is no next cycle
        return self._command(self._tau, None, None)

    def _reset(self, now: float) -> None:
        if self.solving:
            raise InputRefused(f"command 'reset' is refused while {self.mode.value}; use 'deactivate' or 'damp' first")
        self._enter(Mode.INACTIVE, now, None)

    def _activate(self, now: float, problem: Fault | None) -> bool:
        if self.solving:
            raise InputRefused(f"command 'activate' has no effect: the controller is {self.mode.value} already")
        if self.mode is not Mode.INACTIVE:
            code = f" ({self.fault.code})" if self.fault is not None else ""
            raise InputRefused(f"command 'activate' is refused in {self.mode.value}{code}; send 'reset' first")
        problem = problem or (self._watch.doubt if self._watch is not None else None)
        if problem is not None:
            raise InputRefused(f"command 'activate' is refused: {problem.sentence}")
        self._enter(Mode.ACTIVE, now, None)
        self._activated = now
        if self._fall is not None:
            self._fall.begin()
        self._held_time, self._relaxed_time = Budget(), Budget()
        self._relaxed, self._was_relaxed = {}, False
        self._share = Ramp(now, self.limits.activation_ramp, 0.0, 1.0)
        self._taken_over = False
        return True

    def _enter(self, mode: Mode, now: float, fault: Fault | None) -> None:
        self.mode, self.fault, self._since = mode, fault, now

    def step(
        self,
        now: float,
        state: RobotState | None,
        joint_velocity: Array | None,
        problem: Fault | None,
        outcome: Solution | NoSolution | Fault | None,
    ) -> JointCommand | None:
        """Make this cycle's command.

        Args:
            now: s, on the clock of the loop.
            joint_velocity: joint velocities, (nj,) in rad/s; None where they are not fresh.
            outcome: the solution, or why there is none.

        Returns:
            The command; None where nothing is to be sent.
        """
        self._pass(now)
        if self._watch is not None and state is not None:
            doubt = self._watch.look(state)
            problem = problem or doubt
        if self.solving:
            if self._fall is not None and state is not None and problem is None:
                problem = self._fall.look(now, state)
            if problem is not None:
                self._enter(Mode.DAMPING, now, problem)
            elif isinstance(outcome, Solution):
                command = self._follow(now, state, joint_velocity, outcome)
                if command is not None:
                    return command
            elif isinstance(outcome, Fault):
                self._enter(Mode.DAMPING, now, outcome)
            elif isinstance(outcome, NoSolution):
                self._hold(now, Fault("NO_SOLUTION", str(outcome), outcome.infeasibility))
            else:
                self._hold(now, Fault("NO_SOLUTION", "no solution was computed"))
        return self._do_without(now, state, joint_velocity)

    def _pass(self, now: float) -> None:
        """Let time pass: what the torques change by depends on it, and how long holding and relaxing have lasted."""
        elapsed, self._stepped = now - self._stepped, now
        if not (elapsed >= 0.0):  # the clock went back: its times begin anew
            elapsed, self._since = 0.0, min(self._since, now)
        # A simulation may settle its torques before it begins: its time stands still from the activation on.
        settling = now == self._activated and self.mode is _ACTIVE
        self._passed = self._period if settling else elapsed
        if self.mode is _HOLDING:
            self._held_time.spend(now, elapsed)
        if self._was_relaxed:
            self._relaxed_time.spend(now, elapsed)
            self._was_relaxed = False

    def _follow(
        self, now: float, state: RobotState | None, joint_velocity: Array | None, solution: Solution
    ) -> JointCommand | None:
        """Make the command that follows a solution; None if it cannot be followed: the mode is another one now."""
        share, kept, seen = self._share.sample(now), 0.0, self._no_state if state is None else state
        if self._filter > 0.0 and self._taken_over and share >= 1.0:
            kept = math.exp(-self._passed / self._filter)
        if self._curve is not None:
            self._torques_available[:] = self._available(joint_velocity)
        made, passed = np.empty(self._parts[-1].stop), self._passed
        usable = follow(
            self._command_limits, solution.tau, solution.v_dot, seen.q, seen.v, self._tau, share, kept,
            passed if passed < self._period else self._period, made,
        )  # fmt: skip
        if not usable:
            model, (lower, upper) = self._model, self._torques_available
            self._hold(now, unusable_torques(solution.tau, (lower, upper), model.effort_limits, model.actuators))
            return None
        fault = self._relaxing(now, solution) if solution.relaxed else None
        if fault is not None:
            self._enter(Mode.DAMPING, now, fault)
            return None
        if self.mode is _HOLDING:
            self._enter(Mode.ACTIVE, now, None)  # the ramp continues: holding interrupts neither ramping in nor out
        if share <= 0.0 and self._share.after <= 0.0:
            self._enter(Mode.INACTIVE, now, None)
            return None
        if share >= 1.0 and not self._taken_over:
            self._taken_over = all_true(np.abs(solution.tau - self._tau) <= self._period * self._rate)
        made.setflags(write=False)  # and so the parts
        torques, positions, velocities = self._parts
        self._tau = made[torques]
        return JointCommand(seen.stamp, self._tau, made[positions], made[velocities])

    def _limited(self, tau: Array, available: tuple[Array, Array]) -> Array:
        """Limit torques by the rate from the last ones and, last, by the available ones, (na,) each in N·m."""
        step = min(self._passed, self._period) * self._rate
        lower, upper = available
        limited = np.minimum(np.maximum(tau, self._tau - step), self._tau + step)
        return freeze(np.minimum(np.maximum(limited, lower), upper))

    def _relaxing(self, now: float, solution: Solution) -> Fault | None:
        """Count the time with relaxed constraints."""
        limits = self.limits
        spent = self._relaxed_time.within(now, limits.relax_window)
        if spent == 0.0:
            self._relaxed = {}
        self._relaxed |= dict.fromkeys(solution.relaxed)
        self._was_relaxed = True
        return relaxed_for_too_long(tuple(self._relaxed), spent, limits.relax_time, limits.relax_window)

    def _hold(self, now: float, reason: Fault) -> None:
        """Hold the last torques, for want of a solution; damp where that has taken too long."""
        if self.mode is Mode.ACTIVE:
            self._enter(Mode.HOLDING, now, reason)
            self._held = self._tau
        lasted, limits = now - self._since, self.limits
        held = self._held_time.within(now, limits.hold_window)
        if lasted <= limits.hold_time and held <= limits.hold_time:
            return
        if lasted <= limits.hold_time:
            reason = no_solution_for_too_long(reason, held, limits.hold_time, limits.hold_window)
        # Only the first failure of a series is explained: keep its explanation.
        explained = self.fault is not None and self.fault.infeasibility is not None
        self._enter(Mode.DAMPING, now, self.fault if explained else reason)

    def _do_without(self, now: float, state: RobotState | None, joint_velocity: Array | None) -> JointCommand | None:
        """Make the command of a cycle that follows no solution; None where nothing is to be sent."""
        if self.mode is Mode.DAMPING and now - self._since > self.limits.damping_time:
            self._enter(Mode.FAULT if self.fault else Mode.STOPPED, now, self.fault)
        if self.mode is Mode.INACTIVE and not self._tau.any():
            return None
        if joint_velocity is not None:
            joint_velocity = self._trusted(joint_velocity)
        if self.mode is Mode.HOLDING:
            tau = self._holding(state, joint_velocity) + self._damping(joint_velocity)
        elif self.mode is Mode.DAMPING:
            tau = self._damping(joint_velocity)
        else:
            tau = self._no_torque
        return self._command(tau, state, joint_velocity)

    def _trusted(self, joint_velocity: Array) -> Array | None:
        """Joint velocities, (nj,), without those that are not plausible; None where one is not finite."""
        if self._watch is not None:
            return self._watch.damped(joint_velocity)
        return joint_velocity if all_finite(joint_velocity) else None

    def _holding(self, state: RobotState | None, joint_velocity: Array | None) -> Array:
        """The torques at the start of holding, (na,) in N·m, but for what drives a joint into its stop."""
        model = self._model
        if state is None or joint_velocity is None:
            return self._held
        soon = state.q[model.q_places] + _AHEAD * joint_velocity
        held = model.actuation.at_joints(self._held)
        driven = np.where(soon > model.position_upper, held > 0.0, (soon < model.position_lower) & (held < 0.0))
        driven &= held * joint_velocity > 0.0
        return model.actuation.from_joints(np.where(driven, 0.0, held)) if driven.any() else self._held

    def _damping(self, joint_velocity: Array | None) -> Array:
        """Torques that damp every joint, as far as the actuators can; zero where the velocities are not known."""
        if joint_velocity is None:
            return self._no_torque
        return -(self._damping_matrix @ joint_velocity)

    def _available(self, joint_velocity: Array | None) -> tuple[Array, Array]:
        """Lower and upper bounds of the torques, both (na,) in N·m: the effort limits where no speed lowers them."""
        if self._curve is None or joint_velocity is None:
            return self._effort_limits
        trusted = self._trusted(joint_velocity)
        if trusted is None:
            return self._effort_limits
        return self._curve.available(self._model.effort_limits, self._model.actuation.rates(trusted))

    def _command(self, tau: Array, state: RobotState | None, joint_velocity: Array | None) -> JointCommand:
        """Make a command that says nothing about where it leads."""
        self._tau = self._limited(tau, self._available(joint_velocity))
        return JointCommand(state.stamp if state is not None else 0, self._tau, self._nowhere, self._nowhere)
