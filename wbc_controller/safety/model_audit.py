"""The live audit: checks that the latched states and the torques sent obey the laws of motion.

Between two states the energy must change by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint must accelerate by the equations of motion (S1). A
residual indicates a wrong model, a torque that did not arrive as it was sent, or an unknown external force.

The balances are those of `mechanics.energy.energy_residual` and `mechanics.momentum.momentum_residual`, from what the
snapshot of a cycle holds already: M, the centre of mass and its velocity. In each cycle one kernel adds up what the
torques have done and what was not predicted. At the end of a span of cycles, a twentieth of the time constant, the
sums go through the filter: a mean of residuals, for which energy and M are needed only there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from wbc_controller.compiled import Bound
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution
from wbc_controller.safety.model_audit_kernels import SUMS, THROUGHPUT, WORK, follow, look_back, mechanical_energy

#: Largest time between two states that are compared, in control periods; beyond it, states were lost in between.
_LARGEST_GAP = 3.5
#: Time after which the sums go through the filter, as a share of its time constant.
_SPAN = 0.05


@dataclass(frozen=True, slots=True)
class AuditLimits:
    """Limits on the residuals.

    Attributes:
        time_constant: time constant of the filter on the residuals, s.
        patience: time for which a residual must be too large before there is a warning, s.
        energy: largest energy residual, as a share of the joint power.
        power: smallest joint power for that comparison, W.
        force: largest unexplained force on the centre of mass, N.
        torques: largest unexplained torque of each joint, (nj,) in N·m.
        period: control period, s.
    """

    time_constant: float
    patience: float
    energy: float
    power: float
    force: float
    torques: Array
    period: float


class ModelAudit:
    """Compares each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, limits: AuditLimits) -> None:
        """Make an audit.

        Args:
            model: the robot's model.
            limits: limits on the residuals.
        """
        self._model = model
        self._limits = limits
        self._mass = model.mass
        self._gravity = model.mass * np.array(model.pinocchio.gravity.linear)  # N
        self._weight = model.mass * model.gravity
        self._span = _SPAN * limits.time_constant - 0.5 * limits.period  # the nearest number of periods
        self._largest_gap = _LARGEST_GAP * limits.period
        self._none = np.zeros(0)
        self._sums, self._vectors = np.zeros(SUMS), np.zeros((2, model.nv))
        self._last = np.zeros(model.nq + 2 * model.nv + model.na)  # what the kernel was given at the state before
        self._force, self._torques = np.zeros(3 if model.floating_base else 0), np.zeros(model.nv)  # filtered
        self._bound_of: Dynamics | None = None
        self._bound: Bound
        self._looking_back: Bound
        self._forget()

    def _forget(self) -> None:
        """Begin anew, with nothing to compare with."""
        self._before: RobotState | None = None  # the state before, its solution where that predicts the motion, the
        self._solution: Solution | None = None  # forces of springs, and the powers of known wrenches in it, W
        self._springs = self._none
        self._powers: list[float] = []
        self._sums[:], self._vectors[:] = 0.0, 0.0
        self._lasted = self._stored = 0.0  # time of the span so far, s, and the energy at its start, J
        self._energy = self._throughput = 0.0
        self._force[:], self._torques[:] = 0.0, 0.0
        self._since: dict[str, float] = {}
        self._report: AuditReport | None = None

    def look(
        self, state: RobotState, dynamics: Dynamics, solution: Solution | None, command: JointCommand | None
    ) -> AuditReport | None:
        """Compare this cycle's state with the previous one.

        Args:
            state: latched state of this cycle.
            dynamics: the controller's snapshot; of this state, where there is a solution.
            solution: solution of this cycle; None where the controller is not active, or has found none.
            command: command sent in this cycle.

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
            gap = (state.stamp - before.stamp) * 1.0e-9
            if gap <= 0.0:  # the same state again: keep the older one, with its torques
                return None
            if gap > self._largest_gap:
                self._forget()
                gap, before = 0.0, None
        self._follow(before, state, dynamics, solution, command, gap)
        if before is None:
            self._stored = mechanical_energy(self._looking_back.table, state.v)
            return None
        self._lasted += gap
        if self._lasted >= self._span:
            self._report = self._look_back(state)
        return self._report

    def _bind(self, dynamics: Dynamics) -> None:
        """Tell compiled code where it finds what is the same in every cycle."""
        S = self._model.actuation.S
        rows, columns = np.nonzero(S)
        *_, com_velocity, com_drift, per_mass, _, _ = dynamics.terms
        self._bound_of = dynamics
        self._bound = Bound(
            len(rows), self._model.nq, self._model.nv, self._model.na, rows.astype(np.int64), columns.astype(np.int64),
            S[rows, columns], np.array([self._mass]), com_velocity, per_mass, com_drift, self._sums, self._vectors,
            self._last,
        )  # fmt: skip
        model, limits = self._model, self._limits
        to_joints = np.column_stack([model.joint_forces(component) for component in np.eye(model.nv)])
        joints, components = np.nonzero(to_joints)
        self._looking_back = Bound(
            model.nv, model.nj, len(joints), len(self._force), dynamics.M_rows, dynamics.com, self._gravity,
            components.astype(np.int64), joints.astype(np.int64), to_joints[joints, components], limits.torques,
            self._sums, self._vectors, self._force, self._torques, np.array([limits.time_constant]),
        )  # fmt: skip

    def _follow(
        self,
        before: RobotState | None,
        state: RobotState,
        dynamics: Dynamics,
        solution: Solution,
        command: JointCommand,
        gap: float,
    ) -> None:
        """Add what happened since the state before."""
        model, predicted = self._model, self._solution
        beside = moved = self._none
        if predicted is not None and predicted.disturbance is not None:
            beside = predicted.disturbance.forces
        if model.passive is not None:  # the mean of a spring's force at both states gives its exact work
            start, self._springs = self._springs, model.passive_force(state.q, state.v)
            if before is not None:
                springs = 0.5 * (start + self._springs)
                beside = beside + springs if len(beside) else springs
        if before is not None:
            if len(beside):
                moved = model.difference(before.q, state.q)
            if self._powers and predicted is not None:
                # The work of constant torques is exact, that of constant wrenches to second order in the time.
                for first, last in zip(self._powers, _powers(predicted, dynamics), strict=True):
                    self._sums[WORK] += 0.5 * gap * (first + last)
                    self._sums[THROUGHPUT] += 0.5 * gap * abs(first + last)
        if dynamics is not self._bound_of:
            self._bind(dynamics)
        predicts = follow(
            self._bound.table, gap, beside, moved, state.q, state.v, solution.v_dot, command.tau, solution.tau
        )
        self._before = state
        self._solution = solution if predicts else None  # torques that are not the solution's: it predicts nothing
        self._powers = _powers(solution, dynamics) if predicts and solution.external_wrenches else []

    def _look_back(self, state: RobotState) -> AuditReport:
        """Put a span through the filter, and begin the next one."""
        lasted, self._lasted = self._lasted, 0.0
        found = np.empty(3 + self._model.nj)
        self._stored, self._energy, self._throughput, size, most, worst = look_back(
            self._looking_back.table, lasted, state.v, self._stored, self._energy, self._throughput, found
        )
        found.setflags(write=False)  # and so its parts
        force, torques, limits = found[:3], found[3:], self._limits
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
