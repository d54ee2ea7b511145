"""Supervisor: modes, and the only source of a `JointCommand`.

::

    inactive ── activate ──> active <──> holding        no solution: last torques plus damping, for `hold_time` in all
       ^ ^ <── deactivate ──   │            │
       │                       v            v
     reset               damping ──────────────> fault (or stopped, after a user's request)
       └─────────────── from damping, stopped and fault

From every mode `estop` leads to fault, and the end of the process to stopped, both with zero torques at once, as does
unexplained motion (`bring_up`). Damping without velocities is a ramp to zero. A fault is latched until `reset`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.errors import InputRefused, NoSolution, require_known
from wbc_controller.inverse_dynamics.arrays import all_true
from wbc_controller.inverse_dynamics.limits.torque import TorqueSpeedCurve
from wbc_controller.inverse_dynamics.references.trajectories import Ramp
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import REQUESTS, Array, Fault, JointCommand, Mode, RobotState, Solution, freeze, frozen
from wbc_controller.safety.bring_up import UNEXPLAINED_MOTION
from wbc_controller.safety.checks import TORQUE_TOLERANCE, unusable_torques
from wbc_controller.safety.damping import damping_matrix, stable_damping
from wbc_controller.safety.plausibility import Budget, FallWatch, StateWatch
from wbc_controller.safety.supervisor_kernels import CommandLimits, follow
from wbc_controller.settings.service import SafetySettings

_AHEAD = 0.05  # look-ahead to position limits during holding, s
#: Largest rate of filtered torques, as a share of the limit: faster ones shake the legs at touchdowns.
FILTERED_RATE = 0.33
Answer = Solution | NoSolution | Fault | None  # of the quadratic program


@dataclass(frozen=True, slots=True)
class SupervisorLimits:
    """Timing and limits."""

    safety: SafetySettings
    torque_rate: float  # torque rate limit, in effort limits per second
    period: float  # s
    torque_speed: TorqueSpeedCurve | None = None  # None for effort limits at every speed
    velocity_delay: float = 0.0  # delay of the joint velocities, s
    torque_filter: float = 0.0  # time constant of the low-pass on torques, s; 0 for none


class Supervisor:
    """Decides in every cycle which command is sent to the joints.

    `fault` is the reason for leaving the active mode, latched until `reset`. `torques_sent`, (na,) in N·m, are set for
    a replaced or withdrawn command.
    """

    #: State between cycles.
    STATE_FIELDS = (
        "mode", "fault", "_since", "_last_step", "_activated", "_held_time", "_relaxed_time", "_relaxed",
        "_was_relaxed", "_share", "torques_sent", "_held", "_reached_solution", "_watch", "_fall",
    )  # fmt: skip

    def __init__(self, model: RobotModel, limits: SupervisorLimits) -> None:
        self.mode = Mode.INACTIVE
        self.fault: Fault | None = None
        self._model = model
        self._effort_limits = (-model.effort_limits, model.effort_limits)
        self._torques_available = np.array(self._effort_limits)
        self.limits, self._safety = limits, limits.safety
        self._period = self._elapsed = limits.period  # s
        self._rate = limits.torque_rate * model.effort_limits  # N·m/s
        self._filter, self._curve = limits.torque_filter, limits.torque_speed
        D = stable_damping(model, self._safety.damping, limits.period + limits.velocity_delay)
        self._damping_matrix = damping_matrix(model.actuation, D)  # (na, nj)
        self._watch, self._fall = StateWatch(model, self._safety), FallWatch(model, self._safety)
        self._command_limits = CommandLimits(
            limits=model.effort_limits,
            rate=self._rate,
            available=self._torques_available,
            tolerance=TORQUE_TOLERANCE,
            q_index=model.q_index,
            v_index=model.v_index,
            period=self._period,
        )
        self._since = 0.0  # start of the present mode, s
        self._last_step = -math.inf  # time of the last step, s
        self._activated = -math.inf  # time of the last activation, s
        self._held_time, self._relaxed_time = Budget(), Budget()
        self._relaxed: dict[str, None] = {}  # constraints relaxed within the window
        self._was_relaxed = False  # of the last solution
        self._share = Ramp(0.0, 0.0, 0.0, 0.0)  # sent share of the solution's torques
        self._no_torque = frozen(np.zeros(model.na))
        self.torques_sent = self._no_torque
        self._held = self._no_torque  # torques at the start of holding
        self._reached_solution = False  # since the activation
        self._no_state = RobotState(0, frozen(np.full(model.nq, np.nan)), frozen(np.full(model.nv, np.nan)))
        na, nj = model.na, model.nj
        self._slices = slice(0, na), slice(na, na + nj), slice(na + nj, na + 2 * nj)  # of a command
        self._no_motion = frozen(np.full(model.nj, np.nan))

    @property
    def solving(self) -> bool:
        """True if this cycle needs a solution."""
        return self.mode is Mode.ACTIVE or self.mode is Mode.HOLDING

    def torques_before(self, now: float) -> Array | None:
        """Return the torques for the rate limit of the QP; None during the ramp to the solution."""
        if self.mode is Mode.ACTIVE and self._reached_solution and self._share.sample(now) >= 1.0:
            return self.torques_sent
        return None

    def request(self, word: str, now: float, problem: Fault | None) -> bool:
        """Process a request, one of `REQUESTS`; return True if it activates the controller.

        Raises InputRefused if the request is unknown or impossible now, also due to `problem`, the fault of the inputs.
        """
        require_known(word, REQUESTS, "command", " is unknown", InputRefused)
        if word == "estop":
            self._enter(Mode.FAULT, now, Fault("ESTOP", "emergency stop by command"))
            self.torques_sent = self._no_torque  # at once, without a rate
        elif word == "reset":
            if self.solving:
                raise InputRefused(
                    f"command 'reset' is refused while {self.mode.value}; use 'deactivate' or 'damp' first"
                )
            self._enter(Mode.INACTIVE, now, None)
        elif word == "activate":
            return self._activate(now, problem)
        elif self.mode is Mode.INACTIVE:
            raise InputRefused(f"command {word!r} has no effect: the controller is inactive")
        elif not self.solving:
            raise InputRefused(f"command {word!r} has no effect: the controller is {self.mode.value}; use 'reset'")
        elif word == "damp":
            self._enter(Mode.DAMPING, now, self.fault)
        elif self._share.after > 0.0:
            self._share = self._share.towards(0.0, now, self._safety.activation_ramp)
        return False

    def continue_from(self, torques: Array, command: JointCommand) -> JointCommand:
        """Limit a command to one period's change from torques that the guard sent, (na,) in N·m."""
        step = self._period * self._rate
        self.torques_sent = freeze(np.clip(command.tau, torques - step, torques + step))
        return command._replace(tau=self.torques_sent)

    def explain(self, failure: NoSolution) -> None:
        """Add the conflicting constraints to a present ``NO_SOLUTION`` fault."""
        if self.fault is not None and self.fault.code == "NO_SOLUTION":
            self.fault = Fault("NO_SOLUTION", str(failure), failure.infeasibility)

    def shut_down(self, now: float) -> JointCommand | None:
        """Return a last command with zero torques at the end of the process; None if nothing was sent."""
        if self.mode is Mode.INACTIVE and not self.torques_sent.any():
            return None
        self._enter(Mode.STOPPED, now, self.fault)
        self.torques_sent = self._no_torque  # at once
        return self._command(self.torques_sent, None, None)

    def _activate(self, now: float, problem: Fault | None) -> bool:
        if self.solving:
            raise InputRefused(f"command 'activate' has no effect: the controller is {self.mode.value} already")
        if self.mode is not Mode.INACTIVE:
            code = f" ({self.fault.code})" if self.fault is not None else ""
            raise InputRefused(f"command 'activate' is refused in {self.mode.value}{code}; send 'reset' first")
        problem = problem or self._watch.fault
        if problem is not None:
            raise InputRefused(f"command 'activate' is refused: {problem.sentence}")
        self._enter(Mode.ACTIVE, now, None)
        self._activated = now
        self._fall.begin()
        self._held_time, self._relaxed_time = Budget(), Budget()
        self._relaxed, self._was_relaxed = {}, False
        self._share = Ramp(now, self._safety.activation_ramp, 0.0, 1.0)
        self._reached_solution = False
        return True

    def _enter(self, mode: Mode, now: float, fault: Fault | None) -> None:
        self.mode, self.fault, self._since = mode, fault, now

    def step(
        self, now: float, state: RobotState | None, joint_velocity: Array | None, problem: Fault | None, outcome: Answer
    ) -> JointCommand | None:
        """Return the command of this cycle, or None; `joint_velocity` must be fresh, (nj,) in rad/s, or None."""
        self._update_time(now)
        if state is not None:
            fault = self._watch.check(state)
            problem = problem or fault
        if self.solving:
            if state is not None and problem is None:
                problem = self._fall.check(now, state)
            if problem is not None and problem.code == UNEXPLAINED_MOTION:
                self._enter(Mode.FAULT, now, problem)
                self.torques_sent = self._no_torque  # at once, and without damping: it may drive other joints
            elif problem is not None:
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
        return self._command_without_solution(now, state, joint_velocity)

    def _update_time(self, now: float) -> None:
        elapsed, self._last_step = now - self._last_step, now
        if not (elapsed >= 0.0):  # restart of the clock
            elapsed, self._since = 0.0, min(self._since, now)
        # Simulations settle their torques at a constant time before they start.
        settling = now == self._activated and self.mode is Mode.ACTIVE
        self._elapsed = self._period if settling else elapsed
        if self.mode is Mode.HOLDING:
            self._held_time.spend(now, elapsed)
        if self._was_relaxed:
            self._relaxed_time.spend(now, elapsed)
            self._was_relaxed = False

    def _follow(
        self, now: float, state: RobotState | None, joint_velocity: Array | None, solution: Solution
    ) -> JointCommand | None:
        """Return the command of a solution; None if not usable."""
        share, kept, seen = self._share.sample(now), 0.0, self._no_state if state is None else state
        passed = self._elapsed if self._elapsed < self._period else self._period
        if self._filter > 0.0 and self._reached_solution and share >= 1.0:
            kept = math.exp(-self._elapsed / self._filter)
            passed *= FILTERED_RATE  # the time step of the rate limit
        if self._curve is not None:
            self._torques_available[:] = self._available(joint_velocity)
        made = np.empty(self._slices[-1].stop)
        usable = follow(
            self._command_limits, solution.tau, solution.v_dot, seen.q, seen.v, self.torques_sent, share, kept,
            passed, made,
        )  # fmt: skip
        if not usable:
            model, (lower, upper) = self._model, self._torques_available
            self._hold(now, unusable_torques(solution.tau, (lower, upper), model.effort_limits, model.actuators))
            return None
        fault = self._count_relaxation(now, solution) if solution.relaxed else None
        if fault is not None:
            self._enter(Mode.DAMPING, now, fault)
            return None
        if self.mode is Mode.HOLDING:
            self._enter(Mode.ACTIVE, now, None)  # the ramp continues
        if share <= 0.0 and self._share.after <= 0.0:
            self._enter(Mode.INACTIVE, now, None)
            return None
        if share >= 1.0 and not self._reached_solution:
            self._reached_solution = all_true(np.abs(solution.tau - self.torques_sent) <= self._period * self._rate)
        made.setflags(write=False)
        torques, positions, velocities = self._slices
        self.torques_sent = made[torques]
        return JointCommand(seen.stamp, self.torques_sent, made[positions], made[velocities])

    def _count_relaxation(self, now: float, solution: Solution) -> Fault | None:
        limits = self._safety
        spent = self._relaxed_time.within(now, limits.relax_window)
        if spent == 0.0:
            self._relaxed = {}
        self._relaxed |= dict.fromkeys(solution.relaxed)
        self._was_relaxed = True
        if spent <= limits.relax_time:
            return None
        names, limit = ", ".join(self._relaxed), f"limit {1e3 * limits.relax_time:.0f} ms, safety.relax_time"
        text = f"{names}: relaxed for {1e3 * spent:.0f} ms within {limits.relax_window:g} s ({limit})"
        return Fault("RELAXED", text)

    def _hold(self, now: float, reason: Fault) -> None:
        if self.mode is Mode.ACTIVE:
            self._enter(Mode.HOLDING, now, reason)
            self._held = self.torques_sent
        lasted, limits = now - self._since, self._safety
        held = self._held_time.within(now, limits.hold_window)
        if lasted <= limits.hold_time and held <= limits.hold_time:
            return
        if lasted <= limits.hold_time:
            limit = f"limit {1e3 * limits.hold_time:.0f} ms, safety.hold_time"
            text = f"held the last torques for {1e3 * held:.0f} ms within {limits.hold_window:g} s ({limit})"
            reason = replace(reason, sentence=f"{text}: {reason.sentence}")
        # Keep the explanation of the first failure.
        explained = self.fault is not None and self.fault.infeasibility is not None
        self._enter(Mode.DAMPING, now, self.fault if explained else reason)

    def _command_without_solution(
        self, now: float, state: RobotState | None, joint_velocity: Array | None
    ) -> JointCommand | None:
        if self.mode is Mode.DAMPING and now - self._since > self._safety.damping_time:
            self._enter(Mode.FAULT if self.fault else Mode.STOPPED, now, self.fault)
        if self.mode is Mode.INACTIVE and not self.torques_sent.any():
            return None
        if joint_velocity is not None:
            joint_velocity = self._watch.plausible_velocities(joint_velocity)
        if self.mode is Mode.HOLDING:
            tau = self._holding_torques(state, joint_velocity) + self._damping_torques(joint_velocity)
        elif self.mode is Mode.DAMPING:
            tau = self._damping_torques(joint_velocity)
        else:
            tau = self._no_torque
        return self._command(tau, state, joint_velocity)

    def _holding_torques(self, state: RobotState | None, joint_velocity: Array | None) -> Array:
        model = self._model
        if state is None or joint_velocity is None:
            return self._held
        soon = state.q[model.q_places] + _AHEAD * joint_velocity
        held = model.actuation.at_joints(self._held)
        driven = np.where(soon > model.position_upper, held > 0.0, (soon < model.position_lower) & (held < 0.0))
        driven &= held * joint_velocity > 0.0
        return model.actuation.from_joints(np.where(driven, 0.0, held)) if driven.any() else self._held

    def _damping_torques(self, joint_velocity: Array | None) -> Array:
        if joint_velocity is None:
            return self._no_torque
        return -(self._damping_matrix @ joint_velocity)

    def _available(self, joint_velocity: Array | None) -> tuple[Array, Array]:
        if self._curve is None or joint_velocity is None:
            return self._effort_limits
        trusted = self._watch.plausible_velocities(joint_velocity)
        if trusted is None:
            return self._effort_limits
        return self._curve.available(self._model.effort_limits, self._model.actuation.rates(trusted))

    def _command(self, tau: Array, state: RobotState | None, joint_velocity: Array | None) -> JointCommand:
        step = min(self._elapsed, self._period) * self._rate
        limited = np.minimum(np.maximum(tau, self.torques_sent - step), self.torques_sent + step)
        lower, upper = self._available(joint_velocity)
        self.torques_sent = freeze(np.minimum(np.maximum(limited, lower), upper))
        stamp = 0 if state is None else state.stamp
        return JointCommand(stamp, self.torques_sent, self._no_motion, self._no_motion)
