"""The live audit: checks that the latched states and the torques sent obey the laws of motion.

Between two states the energy must change by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint must accelerate by the equations of motion (S1). A
residual indicates a wrong model, a torque that did not arrive as it was sent, or an unknown external force.

The balances are those of `mechanics.energy.energy_residual` and `mechanics.momentum.momentum_residual`, from what the
snapshot of a cycle holds already: M, the centre of mass and its velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.kernels.audit import filter_residuals, joint_powers, mechanical_state
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, freeze, frozen

#: Largest time between two states that are compared, in control periods; beyond it, states were lost in between.
_LARGEST_GAP = 3.5


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


@dataclass(frozen=True, slots=True)
class _Cycle:
    """What the next cycle's state is compared with.

    Attributes:
        state: latched state.
        energy: T + V, J (equation (29)).
        mechanical: linear momentum in the world, in N·s (equation (28)), and the sum of all external forces in the
            solution, in N, world axes, (6,).
        tau: torques sent, (na,) in N·m.
        solution: solution whose torques were sent; None if others were: it then predicts nothing.
        powers: power of each known external wrench of that solution, W.
    """

    state: RobotState
    energy: float
    mechanical: Array
    tau: Array
    solution: Solution | None
    powers: list[float]


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
        self._none = np.zeros(0)
        self._before: _Cycle | None = None
        self._forget()

    def _forget(self) -> None:
        self._energy = self._throughput = 0.0
        self._force = np.zeros(3)
        self._torques = np.zeros(self._model.nv)
        self._since: dict[str, float] = {}

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
            The report; None if there is nothing to compare, as the controller is or was not active, or as states were
            lost.
        """
        before = self._before
        self._before = after = self._cycle(state, dynamics, solution, command)
        if before is None or after is None:
            self._forget()
            return None
        gap = (state.stamp - before.state.stamp) * 1.0e-9
        if gap <= 0.0:  # the same state again: keep the older one, with its torques
            self._before = before
            return None
        if gap > _LARGEST_GAP * self._limits.period:
            self._forget()
            return None
        self._filter(before, after, dynamics, gap)
        torques = freeze(self._model.joint_forces(self._torques))
        return AuditReport(
            energy=self._energy,
            throughput=self._throughput,
            force=frozen(self._force),
            joint_torques=torques,
            warnings=self._warnings(state.stamp * 1.0e-9, torques),
        )

    def _cycle(
        self, state: RobotState, dynamics: Dynamics, solution: Solution | None, command: JointCommand | None
    ) -> _Cycle | None:
        if solution is None or command is None:
            return None
        # The solution obeys the equations of motion: gravity, contacts and known wrenches together give m c̈.
        mechanical = np.empty(6)
        energy = mechanical_state(
            dynamics.M, state.v, solution.v_dot, self._gravity, self._mass,
            dynamics.com, dynamics.com_velocity, dynamics.com_jacobian, dynamics.com_drift, mechanical,
        )  # fmt: skip
        sent = (solution.tau == command.tau).all()
        powers = _powers(solution, dynamics) if sent else []
        return _Cycle(state, energy, mechanical, command.tau, solution if sent else None, powers)

    def _filter(self, before: _Cycle, after: _Cycle, dynamics: Dynamics, gap: float) -> None:
        model, predicted = self._model, before.solution
        share = gap / (self._limits.time_constant + gap)
        beside = self._none
        if predicted is not None and predicted.disturbance is not None:
            beside = predicted.disturbance.forces
        if model.passive is not None:  # the mean of a spring's force at both states gives its exact work
            start, end = (model.passive_force(each.state.q, each.state.v) for each in (before, after))
            springs = 0.5 * (start + end)
            beside = beside + springs if len(beside) else springs
        # Contact forces do no work: a contact does not move along the axes that it holds. The work of constant torques
        # is exact, that of constant wrenches is to second order in the time between the states.
        moved = model.difference(before.state.q, after.state.q)
        supplied, throughput = joint_powers(before.tau, model.actuation.S, beside, moved, gap)
        if predicted is not None:
            for first, last in zip(before.powers, _powers(predicted, dynamics), strict=True):
                supplied += 0.5 * (first + last)
                throughput += 0.5 * abs(first + last)
        self._energy += share * ((after.energy - before.energy) / gap - supplied - self._energy)
        self._throughput += share * (throughput - self._throughput)
        if predicted is not None:
            filter_residuals(
                share, gap, dynamics.M, before.state.v, after.state.v, predicted.v_dot,
                before.mechanical, after.mechanical, self._force if model.floating_base else self._none, self._torques,
            )  # fmt: skip

    def _warnings(self, now: float, torques: Array) -> tuple[str, ...]:
        limits, size = self._limits, math.hypot(*self._force.tolist())
        over = np.abs(torques) / limits.torques
        worst = int(over.argmax())
        found: tuple[tuple[str, bool, Callable[[], str]], ...] = (
            ("UNMODELLED_FORCE", size > limits.force, lambda: self._say_force(size)),
            ("UNMODELLED_TORQUE", over.item(worst) > 1.0, lambda: self._say_torque(worst, torques.item(worst))),
            (
                "ENERGY_RESIDUAL",
                abs(self._energy) > limits.energy * max(self._throughput, limits.power),
                lambda: f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass",
            ),
        )
        warnings = []
        for name, wrong, sentence in found:
            if not wrong:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now) >= limits.patience:
                warnings.append(f"{name}: {sentence()}")
        return tuple(warnings)

    def _say_force(self, size: float) -> str:
        direction = ", ".join(f"{part / max(size, 1.0e-9):.2f}" for part in self._force)
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
