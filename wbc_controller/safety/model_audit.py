"""Live audit by the laws of motion.

Between two states, the energy changes by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint accelerates by the equations of motion (S1). A residual
indicates a wrong model, torques not applied as sent, or an unknown force. Sums over a span of cycles enter the filter.
"""

from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, freeze, frozen

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
    """Previous state with its predicted motion."""

    state: RobotState
    tau: Array  # torques sent, (na,) in N·m
    springs: Array | None  # generalized force of passive joints, (nv,), or None
    momentum: Array  # linear momentum m ċ, (3,) in N·s
    force: Array  # predicted m c̈, (3,) in N
    solution: Solution | None  # None if other torques were sent
    powers: list[float]  # of known external wrenches, W


class _Sums:
    """Sums since the start of a span."""

    def __init__(self, nv: int) -> None:
        self.lasted = self.predicted = 0.0  # duration, and the part with a prediction, s
        self.work = self.throughput = 0.0  # work of torques and known forces, and its magnitudes, J
        self.velocity = np.zeros(nv)  # Δv - v̇ Δt
        self.impulse = np.zeros(3)  # Δ(m ċ) - m c̈ Δt, N·s


class ModelAudit:
    """Comparison of each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, limits: AuditLimits) -> None:
        self._model = model
        self._limits = limits
        self._mass = model.mass  # kg
        self._gravity = self._mass * np.array(model.pinocchio.gravity.linear)  # N
        self._weight = self._mass * model.gravity
        self._span = _SPAN * limits.time_constant - 0.5 * limits.period  # rounds to periods
        self._largest_gap = _LARGEST_GAP * limits.period
        #: Joint components of a generalized force, (nj, nv).
        self._to_joints = np.column_stack([model.joint_forces(component) for component in np.eye(model.nv)])
        self._forget()

    def _forget(self) -> None:
        self._before: _Previous | None = None
        self._sums = _Sums(self._model.nv)
        self._stored = 0.0  # energy at the start of the span, J
        self._energy = self._throughput = 0.0
        self._force, self._torques = np.zeros(3), np.zeros(self._model.nv)  # filtered
        self._since: dict[str, float] = {}
        self._report: AuditReport | None = None

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
        previous = self._previous(state, dynamics, solution, command)
        if before is not None:
            self._add(before, previous, dynamics, gap)
        self._before = previous
        if before is None:
            self._stored = self._mechanical_energy(dynamics)
            return None
        if self._sums.lasted >= self._span:
            self._report = self._finish_span(state, dynamics)
        return self._report

    def _mechanical_energy(self, dynamics: Dynamics) -> float:
        return float(0.5 * dynamics.v @ dynamics.M @ dynamics.v - self._gravity @ dynamics.com)

    def _previous(self, state: RobotState, dynamics: Dynamics, solution: Solution, command: JointCommand) -> _Previous:
        model, mass = self._model, self._mass
        predicts = solution.tau.tobytes() == command.tau.tobytes()
        return _Previous(
            state=state,
            tau=command.tau,
            springs=None if model.passive is None else model.passive_force(state.q, state.v),
            momentum=mass * dynamics.com_velocity,
            force=mass * (dynamics.com_jacobian @ solution.v_dot + dynamics.com_drift),
            solution=solution if predicts else None,
            powers=_powers(solution, dynamics) if predicts else [],
        )

    def _add(self, before: _Previous, after: _Previous, dynamics: Dynamics, gap: float) -> None:
        """Add the step between two states to the sums."""
        sums, solution = self._sums, before.solution
        sums.lasted += gap
        force = self._model.actuation.generalized_force(before.tau) + self._other_force(before, after.springs)
        work = (force * self._model.difference(before.state.q, after.state.q)).tolist()  # contact forces do no work
        sums.work += sum(work)
        sums.throughput += sum(map(abs, work))
        if solution is not None:
            sums.predicted += gap
            sums.velocity += after.state.v - before.state.v - gap * solution.v_dot
            sums.impulse += after.momentum - before.momentum - gap * before.force
            if before.powers:
                for start, end in zip(before.powers, _powers(solution, dynamics), strict=True):
                    sums.work += 0.5 * gap * (start + end)
                    sums.throughput += abs(0.5 * gap * (start + end))

    def _other_force(self, before: _Previous, springs: Array | None) -> Array:
        """Return the known generalized force besides the torques, (nv,): disturbance and springs."""
        force = np.zeros(self._model.nv)
        if before.solution is not None and before.solution.disturbance is not None:
            force = before.solution.disturbance.forces
        if before.springs is not None and springs is not None:
            force = force + 0.5 * (before.springs + springs)  # exact for springs
        return force

    def _finish_span(self, state: RobotState, dynamics: Dynamics) -> AuditReport:
        sums, limits, lasted = self._sums, self._limits, self._sums.lasted
        self._sums = _Sums(self._model.nv)
        stored, self._stored = self._stored, self._mechanical_energy(dynamics)
        share = lasted / (limits.time_constant + lasted)
        self._energy += share * ((self._stored - stored - sums.work) / lasted - self._energy)
        self._throughput += share * (sums.throughput / lasted - self._throughput)
        if sums.predicted > 0.0:
            share = sums.predicted / (limits.time_constant + sums.predicted)
            if self._model.floating_base:  # not of a fixed base
                self._force += share * (sums.impulse / sums.predicted - self._force)
            self._torques += share * (dynamics.M @ sums.velocity / sums.predicted - self._torques)
        force, torques = frozen(self._force), freeze(self._to_joints @ self._torques)
        size, over = float(np.linalg.norm(force)), np.abs(torques) / limits.torques
        worst = int(over.argmax())
        direction = ", ".join(f"{part / max(size, 1.0e-9):.2f}" for part in force)
        findings = {
            "UNMODELLED_FORCE": (
                size > limits.force,
                f"{size:.2f} N on the centre of mass along [{direction}], {100.0 * size / self._weight:.2f} % of the "
                "weight: a push, a wrong mass, or a wrong contact",
            ),
            "UNMODELLED_TORQUE": (
                over.item(worst) > 1.0,
                f"{torques.item(worst):.3g} N·m at {self._model.joints[worst]}: torque not applied as sent, friction, "
                "or a wrong inertia",
            ),
            "ENERGY_RESIDUAL": (
                abs(self._energy) > limits.energy * max(self._throughput, limits.power),
                f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass",
            ),
        }
        now, warnings = state.stamp * 1.0e-9, []
        for name, (is_too_large, text) in findings.items():
            if not is_too_large:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now - lasted) >= limits.patience:
                warnings.append(f"{name}: {text}")
        return AuditReport(self._energy, self._throughput, force, torques, tuple(warnings))


def _powers(solution: Solution, dynamics: Dynamics) -> list[float]:
    return [
        float(dynamics.external_force(frame, wrench) @ dynamics.v)
        for frame, wrench in solution.external_wrenches.items()
    ]
