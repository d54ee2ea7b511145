"""Live audit by the laws of motion.

Between two states, the energy changes by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint accelerates by the equations of motion (S1). A residual
indicates a wrong model, torques not applied as sent, or an unknown force. Sums over a span of cycles enter the filter.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, freeze, frozen
from wbc_controller.safety.model_audit_kernels import AuditMemory, add_step, store_state

#: Largest time between two compared states, in control periods.
_LARGEST_GAP = 3.5
#: Duration of a span, as a share of the filter's time constant.
_SPAN = 0.05


@dataclass(frozen=True, slots=True)
class AuditLimits:
    """Limits of the residuals."""

    time_constant: float  # of the filter, s
    patience: float  # time above a limit before a warning, s
    energy: float  # largest energy residual, as a share of the joint power
    power: float  # least joint power of that comparison, W
    force: float  # largest unexplained force on the centre of mass, N
    torques: Array  # largest unexplained torque of each joint, (nj,) in N·m
    period: float  # control period, s


@dataclass(frozen=True, slots=True)
class _Previous:
    """Previous state; its motion and torques are in `AuditMemory`."""

    state: RobotState
    springs: Array | None  # generalized force of passive joints, (nv,), or None
    solution: Solution | None  # None if other torques were sent
    powers: list[float]  # of known external wrenches, W


class ModelAudit:
    """Comparison of each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, limits: AuditLimits) -> None:
        self._model = model
        self._limits = limits
        self._gravity = model.mass * np.array(model.pinocchio.gravity.linear)  # N
        self._weight = model.mass * model.gravity
        self._span = _SPAN * limits.time_constant - 0.5 * limits.period  # rounds to periods
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
        self._before: _Previous | None = None
        self._clear()
        self._lasted = self._stored = 0.0  # duration of the span, s, and energy at its start, J
        self._energy = self._throughput = 0.0
        self._force, self._torques = np.zeros(3), np.zeros(self._model.nv)  # filtered
        self._since: dict[str, float] = {}
        self._report: AuditReport | None = None

    def _clear(self) -> None:
        for sums in (self._memory.velocity, self._memory.impulse, self._memory.totals):
            sums.fill(0.0)

    def check(
        self, state: RobotState, dynamics: Dynamics, solution: Solution | None, command: JointCommand | None
    ) -> AuditReport | None:
        """Compare this state with the previous one; return the report of the last span, or None."""
        before = self._before
        if solution is None or command is None:
            if before is not None:
                self._forget()
            return None
        gap = 0.0
        if before is not None:
            gap = (state.stamp - before.state.stamp) * 1.0e-9
            if gap <= 0.0:  # repeated state: keep the first torques
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
            self._report = self._finish_span(state, dynamics)
        return self._report

    def _mechanical_energy(self, dynamics: Dynamics) -> float:
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
        memory = self._memory
        springs = None if self._model.passive is None else self._model.passive_force(state.q, state.v)
        if before is not None:
            step = self._model.difference(before.state.q, state.q)
            other = self._other_force(before, springs)
            add_step(memory, step, state.v, dynamics.com_velocity, other, gap, before.solution is not None)
            if before.solution is not None and before.powers:
                self._add_wrenches(before.powers, _powers(before.solution, dynamics), gap)
        predicts = store_state(
            memory, state.v, dynamics.com_velocity, dynamics.com_jacobian, dynamics.com_drift,
            solution.v_dot, solution.tau, command.tau,
        )  # fmt: skip
        powers = _powers(solution, dynamics) if predicts and solution.external_wrenches else []
        return _Previous(state, springs, solution if predicts else None, powers)

    def _other_force(self, before: _Previous, springs: Array | None) -> Array:
        """Return the known generalized force besides the torques, (nv,): disturbance and springs."""
        force = self._no_force
        if before.solution is not None and before.solution.disturbance is not None:
            force = before.solution.disturbance.forces
        if before.springs is not None and springs is not None:
            force = force + 0.5 * (before.springs + springs)  # exact for springs
        return force

    def _add_wrenches(self, before: list[float], after: list[float], gap: float) -> None:
        for start, end in zip(before, after, strict=True):
            work = 0.5 * gap * (start + end)
            self._memory.totals[1] += work
            self._memory.totals[2] += abs(work)

    def _finish_span(self, state: RobotState, dynamics: Dynamics) -> AuditReport:
        lasted, self._lasted = self._lasted, 0.0
        sums, limits = self._memory, self._limits
        duration, work, throughput = sums.totals.tolist()
        stored, self._stored = self._stored, self._mechanical_energy(dynamics)
        share = lasted / (limits.time_constant + lasted)
        self._energy += share * ((self._stored - stored - work) / lasted - self._energy)
        self._throughput += share * (throughput / lasted - self._throughput)
        if duration > 0.0:
            share = duration / (limits.time_constant + duration)
            if self._model.floating_base:  # not of a fixed base
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
            descriptions: dict[str, Callable[[], str]] = {
                "UNMODELLED_FORCE": lambda: self._describe_force(force, size),
                "UNMODELLED_TORQUE": lambda: self._describe_torque(worst, torques.item(worst)),
                "ENERGY_RESIDUAL": self._describe_energy,
            }
            lasting = self._persistent(state.stamp * 1.0e-9, lasted, wrong)
            warnings = tuple(f"{name}: {descriptions[name]()}" for name in lasting)
        return AuditReport(self._energy, self._throughput, force, torques, warnings)

    def _persistent(self, now: float, lasted: float, wrong: Mapping[str, bool]) -> list[str]:
        found = []
        for name, is_wrong in wrong.items():
            if not is_wrong:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now - lasted) >= self._limits.patience:
                found.append(name)
        return found

    def _describe_energy(self) -> str:
        return f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass"

    def _describe_force(self, force: Array, size: float) -> str:
        direction = ", ".join(f"{part / max(size, 1.0e-9):.2f}" for part in force)
        return (
            f"{size:.2f} N on the centre of mass along [{direction}], {100.0 * size / self._weight:.2f} % of the "
            "weight: a push, a wrong mass, or a wrong contact"
        )

    def _describe_torque(self, joint: int, torque: float) -> str:
        return (
            f"{torque:.3g} N·m at {self._model.joints[joint]}: torque not applied as sent, friction, or a wrong inertia"
        )


def _powers(solution: Solution, dynamics: Dynamics) -> list[float]:
    return [
        float(dynamics.external_force(frame, wrench) @ dynamics.v)
        for frame, wrench in solution.external_wrenches.items()
    ]
