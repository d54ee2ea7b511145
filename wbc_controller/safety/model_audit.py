"""The live audit: checks that the latched states and the torques sent obey the laws of motion.

Between two states the energy must change by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint must accelerate by the equations of motion (S1). A
residual indicates a wrong model, a torque that did not arrive as it was sent, or an unknown external force.

The balances are those of `mechanics.energy.energy_residual` and `mechanics.momentum.momentum_residual`, from the terms
of a cycle's snapshot: M, the centre of mass and its velocity. Each cycle adds the work of the torques and the motion
that was not predicted to sums. At the end of a span of cycles, a twentieth of the time constant, the sums go through
the filter: a mean of residuals, for which energy and M are needed only there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, freeze, frozen
from wbc_controller.safety.model_audit_kernels import AuditMemory, add_step, keep_state

#: Largest time between two states that are compared, in control periods; beyond it, states were lost in between.
_LARGEST_GAP = 3.5
#: Time after which the sums go through the filter, as a share of its time constant.
_SPAN = 0.05


@dataclass(frozen=True, slots=True)
class AuditLimits:
    """Limits on the residuals."""

    time_constant: float  # time constant of the filter on the residuals, s
    patience: float  # time for which a residual must be too large before there is a warning, s
    energy: float  # largest energy residual, as a share of the joint power
    power: float  # smallest joint power for that comparison, W
    force: float  # largest unexplained force on the centre of mass, N
    torques: Array  # largest unexplained torque of each joint, (nj,) in N·m
    period: float  # control period, s


@dataclass(frozen=True, slots=True)
class _Previous:
    """The state before; its motion and the torques are in the memory of the sums."""

    state: RobotState
    springs: Array | None  # generalized force of passive joints in it, (nv,); None without passive joints
    solution: Solution | None  # its solution; None if the torques sent are other ones: it predicts nothing
    powers: list[float]  # powers of known external wrenches of the solution, W


class ModelAudit:
    """Compares each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, limits: AuditLimits) -> None:
        """Make an audit."""
        self._model = model
        self._limits = limits
        self._gravity = model.mass * np.array(model.pinocchio.gravity.linear)  # N
        self._weight = model.mass * model.gravity
        self._span = _SPAN * limits.time_constant - 0.5 * limits.period  # the nearest number of periods
        self._largest_gap = _LARGEST_GAP * limits.period
        #: Joint components of a generalized force, (nj, nv).
        self._to_joints = np.column_stack([model.joint_forces(component) for component in np.eye(model.nv)])
        nv, na = model.nv, model.na
        self._memory = AuditMemory(
            S=np.ascontiguousarray(model.actuation.S),
            mass=model.mass,
            v=np.zeros(nv),
            v_dot=np.zeros(nv),
            tau=np.zeros(na),
            momentum=np.zeros(3),
            force=np.zeros(3),
            velocity=np.zeros(nv),
            impulse=np.zeros(3),
            totals=np.zeros(3),
        )
        self._no_force = np.zeros(nv)
        self._forget()

    def _forget(self) -> None:
        """Begin anew, with nothing to compare with."""
        self._before: _Previous | None = None
        self._clear()
        self._lasted = self._stored = 0.0  # time of the span so far, s, and the energy at its start, J
        self._energy = self._throughput = 0.0
        self._force, self._torques = np.zeros(3), np.zeros(self._model.nv)  # filtered
        self._since: dict[str, float] = {}
        self._report: AuditReport | None = None

    def _clear(self) -> None:
        """Set the sums to zero."""
        for sums in (self._memory.velocity, self._memory.impulse, self._memory.totals):
            sums.fill(0.0)

    def look(
        self, state: RobotState, dynamics: Dynamics, solution: Solution | None, command: JointCommand | None
    ) -> AuditReport | None:
        """Compare this cycle's state with the previous one.

        Args:
            dynamics: the controller's snapshot; of this state, where there is a solution.
            solution: solution of this cycle; None where the controller is not active, or has found none.

        Returns:
            The report of the last span; None if there is none yet, as the controller is or was not active, or as states
            were lost, and where a state is given again.
        """
        before = self._before
        if solution is None or command is None:
            if before is not None:
                self._forget()
            return None
        gap = 0.0
        if before is not None:
            gap = (state.stamp - before.state.stamp) * 1.0e-9
            if gap <= 0.0:  # the same state again: keep the older one, with its torques
                return None
            if gap > self._largest_gap:
                self._forget()
                gap, before = 0.0, None
        self._before = self._add(before, state, dynamics, solution, command, gap)
        if before is None:
            self._stored = self._mechanical_energy(dynamics)
            return None
        self._lasted += gap
        if self._lasted >= self._span:
            self._report = self._look_back(state, dynamics)
        return self._report

    def _mechanical_energy(self, dynamics: Dynamics) -> float:
        """Return the energy T + V = ½ vᵀM v - m gᵀc, J."""
        return float(0.5 * dynamics.v @ dynamics.M @ dynamics.v - self._gravity @ dynamics.com)

    def _add(
        self,
        before: _Previous | None,
        state: RobotState,
        dynamics: Dynamics,
        solution: Solution,
        command: JointCommand,
        gap: float,
    ) -> _Previous:
        """Add the step from the state before, Δt = gap s ago, and return this state for the next step."""
        memory = self._memory
        springs = None if self._model.passive is None else self._model.passive_force(state.q, state.v)
        if before is not None:
            step = self._model.difference(before.state.q, state.q)
            other = self._other_force(before, springs)
            add_step(memory, step, state.v, dynamics.com_velocity, other, gap, before.solution is not None)
            if before.solution is not None and before.powers:
                self._add_wrenches(before.powers, _powers(before.solution, dynamics), gap)
        predicts = keep_state(
            memory, state.v, dynamics.com_velocity, dynamics.com_jacobian, dynamics.com_drift,
            solution.v_dot, solution.tau, command.tau,
        )  # fmt: skip
        powers = _powers(solution, dynamics) if predicts and solution.external_wrenches else []
        return _Previous(state, springs, solution if predicts else None, powers)

    def _other_force(self, before: _Previous, springs: Array | None) -> Array:
        """Return the known generalized force besides the torques in a step, (nv,): disturbance and springs."""
        force = self._no_force
        if before.solution is not None and before.solution.disturbance is not None:
            force = before.solution.disturbance.forces
        if before.springs is not None and springs is not None:
            force = force + 0.5 * (before.springs + springs)  # the mean of a spring's force is exact
        return force

    def _add_wrenches(self, before: list[float], after: list[float], gap: float) -> None:
        """Add the work of known external wrenches from their powers in W: exact to second order in the time."""
        for start, end in zip(before, after, strict=True):
            work = 0.5 * gap * (start + end)
            self._memory.totals[1] += work
            self._memory.totals[2] += abs(work)

    def _look_back(self, state: RobotState, dynamics: Dynamics) -> AuditReport:
        """Put a span through the filter, and begin the next one."""
        lasted, self._lasted = self._lasted, 0.0
        sums, limits = self._memory, self._limits
        duration, work, throughput = sums.totals.tolist()
        stored, self._stored = self._stored, self._mechanical_energy(dynamics)
        share = lasted / (limits.time_constant + lasted)
        self._energy += share * ((self._stored - stored - work) / lasted - self._energy)
        self._throughput += share * (throughput / lasted - self._throughput)
        if duration > 0.0:
            share = duration / (limits.time_constant + duration)
            if self._model.floating_base:  # the ground holds a fixed base
                self._force += share * (sums.impulse / duration - self._force)
            self._torques += share * (dynamics.M @ sums.velocity / duration - self._torques)
        self._clear()
        force, torques = frozen(self._force), freeze(self._to_joints @ self._torques)
        size, over = float(np.linalg.norm(force)), np.abs(torques) / limits.torques
        worst = int(over.argmax())
        most = over.item(worst)
        wrong = {
            "UNMODELLED_FORCE": size > limits.force,
            "UNMODELLED_TORQUE": most > 1.0,
            "ENERGY_RESIDUAL": abs(self._energy) > limits.energy * max(self._throughput, limits.power),
        }
        warnings: tuple[str, ...] = ()
        if self._since or True in wrong.values():
            says: dict[str, Callable[[], str]] = {
                "UNMODELLED_FORCE": lambda: self._say_force(force, size),
                "UNMODELLED_TORQUE": lambda: self._say_torque(worst, torques.item(worst)),
                "ENERGY_RESIDUAL": self._say_energy,
            }
            lasting = self._lasting(state.stamp * 1.0e-9, lasted, wrong)
            warnings = tuple(f"{name}: {says[name]()}" for name in lasting)
        return AuditReport(self._energy, self._throughput, force, torques, warnings)

    def _lasting(self, now: float, lasted: float, wrong: Mapping[str, bool]) -> list[str]:
        """What has been too large for too long; a residual stands for all of the span that it is the mean of."""
        found = []
        for name, is_wrong in wrong.items():
            if not is_wrong:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now - lasted) >= self._limits.patience:
                found.append(name)
        return found

    def _say_energy(self) -> str:
        return f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass"

    def _say_force(self, force: Array, size: float) -> str:
        direction = ", ".join(f"{part / max(size, 1.0e-9):.2f}" for part in force)
        return (
            f"{size:.2f} N on the centre of mass along [{direction}], {100.0 * size / self._weight:.2f} % of the "
            "weight: a push, a wrong mass, or a contact that is not as assumed"
        )

    def _say_torque(self, joint: int, torque: float) -> str:
        return (
            f"{torque:.3g} N·m at {self._model.joints[joint]}: a torque that does not arrive as sent, "
            "friction, or a wrong inertia"
        )


def _powers(solution: Solution, dynamics: Dynamics) -> list[float]:
    """Power of each known external wrench of a solution at the state of a snapshot, W."""
    return [
        float(dynamics.external_force(frame, wrench) @ dynamics.v)
        for frame, wrench in solution.external_wrenches.items()
    ]
