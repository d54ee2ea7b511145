"""The live audit: checks that the latched states and the torques sent obey the laws of motion.

Between two states the energy must change by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint must accelerate by the equations of motion (S1). A
residual indicates a wrong model, a torque that did not arrive as it was sent, or an unknown external force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.core.contacts import Contact
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.mechanics.energy import EnergyBalance, energy_residual
from wbc_controller.mechanics.external import ExternalWrench
from wbc_controller.mechanics.momentum import momentum_residual
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, frozen

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
class _Sent:
    """A state, the torques sent for it, and the external wrenches assumed."""

    state: RobotState
    tau: Array
    solution: Solution | None  # None if other torques were sent: it then predicts nothing
    contacts: tuple[ExternalWrench, ...]
    external: tuple[ExternalWrench, ...]


class ModelAudit:
    """Compares each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, contacts: Mapping[str, Contact], limits: AuditLimits) -> None:
        """Make an audit.

        Args:
            model: the robot's model.
            contacts: the robot's contacts, by name.
            limits: limits on the residuals.
        """
        self._model = model
        self._contacts = contacts
        self._limits = limits
        self._data = model.pinocchio.createData()
        self._weight = model.mass * model.gravity
        self._sent: _Sent | None = None
        self._forget()

    def _forget(self) -> None:
        self._energy = self._throughput = 0.0
        self._force = np.zeros(3)
        self._torques = np.zeros(self._model.nj)
        self._since: dict[str, float] = {}

    def look(
        self,
        state: RobotState,
        dynamics: Dynamics,
        solution: Solution | None,
        command: JointCommand | None,
    ) -> AuditReport | None:
        """Compare this cycle's state with the previous one.

        Args:
            state: latched state of this cycle.
            dynamics: dynamics at that state.
            solution: solution of this cycle.
            command: command sent in this cycle.

        Returns:
            The report; None if there is nothing to compare, as no torques were sent or states were lost.
        """
        sent, self._sent = self._sent, self._remember(state, dynamics, solution, command)
        if sent is None:
            self._forget()
            return None
        gap = (state.stamp - sent.state.stamp) * 1.0e-9
        if gap <= 0.0:  # the same state again: keep the older one, with its torques
            self._sent = sent
            return None
        if gap > _LARGEST_GAP * self._limits.period:
            self._forget()
            return None
        self._filter(sent, state, dynamics, gap)
        return AuditReport(
            energy=self._energy,
            throughput=self._throughput,
            force=frozen(self._force),
            joint_torques=frozen(self._torques),
            warnings=tuple(self._warnings(state.stamp * 1.0e-9)),
        )

    def _remember(
        self,
        state: RobotState,
        dynamics: Dynamics,
        solution: Solution | None,
        command: JointCommand | None,
    ) -> _Sent | None:
        if command is None:
            return None
        if solution is None or not np.array_equal(solution.tau, command.tau):
            return _Sent(state, command.tau, None, (), ())
        base = self._model.base_link
        contacts = tuple(
            ExternalWrench(base, self._contacts[name].wrench_in_world(dynamics, force), "WORLD")
            for name, force in solution.forces.items()
            if not self._contacts[name].internal
        )
        external = tuple(ExternalWrench(frame, wrench) for frame, wrench in solution.external_wrenches.items())
        return _Sent(state, command.tau, solution, contacts, external)

    def _filter(self, sent: _Sent, state: RobotState, dynamics: Dynamics, gap: float) -> None:
        model = self._model
        share = gap / (self._limits.time_constant + gap)
        force = model.actuation.generalized_force(sent.tau)
        if model.passive is not None:  # the mean of a spring's force at both states gives its exact work
            ends = (sent.state, state)
            force += 0.5 * sum(model.passive_force(end.q, end.v) for end in ends)
        if model.actuation.rotors is not None:  # Pinocchio's energy covers only links and armature
            force -= model.actuation.rotors @ (state.v - sent.state.v) / gap
        # Contact forces do no work: a contact does not move along the axes that it holds.
        energy: EnergyBalance = energy_residual(
            model.pinocchio, sent.state, state, force, sent.external, data=self._data
        )
        self._energy += share * (energy.residual - self._energy)
        self._throughput += share * (energy.throughput - self._throughput)
        if sent.solution is None:
            return
        if model.floating_base:
            momentum = momentum_residual(
                model.pinocchio, sent.state, state, (*sent.contacts, *sent.external), data=self._data
            )
            self._force += share * (momentum.residual[:3] - self._force)
        unexpected = dynamics.M @ ((state.v - sent.state.v) / gap - sent.solution.v_dot)
        self._torques += share * (model.joint_forces(unexpected) - self._torques)

    def _warnings(self, now: float) -> Sequence[str]:
        limits = self._limits
        size = float(np.linalg.norm(self._force))
        over = np.abs(self._torques) / limits.torques
        worst = int(np.argmax(over))
        found = {
            "UNMODELLED_FORCE": (size > limits.force, self._say_force(size)),
            "UNMODELLED_TORQUE": (bool(over[worst] > 1.0), self._say_torque(worst)),
            "ENERGY_RESIDUAL": (
                abs(self._energy) > limits.energy * max(self._throughput, limits.power),
                f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass",
            ),
        }
        warnings = []
        for name, (wrong, sentence) in found.items():
            if not wrong:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now) >= limits.patience:
                warnings.append(f"{name}: {sentence}")
        return warnings

    def _say_force(self, size: float) -> str:
        direction = ", ".join(f"{part / max(size, 1.0e-9):.2f}" for part in self._force)
        return (
            f"{size:.2f} N on the centre of mass along [{direction}], {100.0 * size / self._weight:.2f} % of the "
            "weight: a push, a wrong mass, or a contact that is not as assumed"
        )

    def _say_torque(self, joint: int) -> str:
        return (
            f"{self._torques[joint]:.3g} N·m at {self._model.joints[joint]}: a torque that does not arrive as sent, "
            "friction, or a wrong inertia"
        )
