"""Live audit by the laws of motion.

Between two states, the energy changes by the work of the torques (equation (29) of the note; S6), the momentum by
gravity and contact forces (equation (26); S5), and every joint accelerates by the equations of motion (S1). A residual
indicates a wrong model, torques not applied as sent, or an unknown force. Sums over a span of cycles enter the filter.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from wbc_controller.inverse_dynamics.arrays import sum_of_squares
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, AuditReport, JointCommand, RobotState, Solution, freeze, frozen
from wbc_controller.settings.service import AuditSettings

_LARGEST_GAP = 3.5  # largest time between two compared states, in control periods
_SPAN = 0.1  # duration of a span, as a share of the filter's time constant


class _Step(NamedTuple):
    """State with the motion predicted from it."""

    state: RobotState
    gap: float  # since the last step, s
    tau: Array  # torques sent, (na,) in N·m
    springs: Array | None  # generalized force of passive joints, (nv,), or None
    com_velocity: Array  # ċ, (3,) in m/s
    com_acceleration: Array  # predicted c̈, (3,) in m/s²
    solution: Solution | None  # None if other torques were sent
    powers: list[float]  # of known external wrenches, W
    last_powers: list[float]  # of the known wrenches of the last step, W


class ModelAudit:
    """Comparison of each state with the motion predicted from the previous state and its torques."""

    def __init__(self, model: RobotModel, settings: AuditSettings, period: float) -> None:
        """Start with the thresholds of the settings and a control period, s."""
        self._model, self._settings = model, settings
        self._mass = model.mass  # kg
        self._gravity = self._mass * np.array(model.pinocchio.gravity.linear)  # N
        self._weight = self._mass * model.gravity
        self._largest_force = settings.force * self._weight  # N
        self._largest_torques = settings.torque * joint_efforts(model)  # (nj,) in N·m
        self._span = _SPAN * settings.time_constant - 0.5 * period  # rounds to periods
        self._largest_gap = _LARGEST_GAP * period
        #: Joint components of a generalized force, (nj, nv).
        self._to_joints = np.column_stack([model.joint_forces(component) for component in np.eye(model.nv)])
        self._forget()

    def _forget(self) -> None:
        self._steps: list[_Step] = []  # of the span; the first one ended the last span
        self._stored = 0.0  # energy at the start of the span, J
        self._energy = self._throughput = 0.0
        self._force, self._torques = np.zeros(3), np.zeros(self._model.nv)  # filtered
        self._since: dict[str, float] = {}
        self._report: AuditReport | None = None

    def check(
        self, state: RobotState, dynamics: Dynamics, solution: Solution | None, command: JointCommand | None
    ) -> AuditReport | None:
        """Compare this state with the previous one; return the report of the last span, or None."""
        if solution is None or command is None:
            if self._steps:
                self._forget()
            return None
        gap = (state.stamp - self._steps[-1].state.stamp) * 1.0e-9 if self._steps else math.inf
        if gap <= 0.0:  # repeated state: keep the first torques
            return None
        if gap > self._largest_gap:
            self._forget()
            self._stored = self._mechanical_energy(dynamics)
        before = self._steps[-1].solution if self._steps else None
        predicts = solution.tau.tobytes() == command.tau.tobytes()
        step = _Step(
            state=state,
            gap=gap,
            tau=command.tau,
            springs=None if self._model.passive is None else self._model.passive_force(state.q, state.v),
            com_velocity=dynamics.com_velocity.copy(),
            com_acceleration=dynamics.com_jacobian @ solution.v_dot + dynamics.com_drift,
            solution=solution if predicts else None,
            powers=_powers(solution, dynamics) if predicts else [],
            last_powers=[] if before is None else _powers(before, dynamics),
        )
        self._steps.append(step)
        if len(self._steps) > 1 and (state.stamp - self._steps[0].state.stamp) * 1.0e-9 >= self._span:
            self._report = self._finish_span(state, dynamics)
        return self._report

    def _mechanical_energy(self, dynamics: Dynamics) -> float:
        return float(0.5 * dynamics.v @ dynamics.M @ dynamics.v - self._gravity @ dynamics.com)

    def _work(self, pairs: Sequence[tuple[_Step, _Step]]) -> Array:
        """Return the work of all known forces between pairs of steps, J; contact forces do no work."""
        force = self._model.actuation.generalized_force(np.array([before.tau for before, _ in pairs]))
        known = []
        for row, (before, after) in zip(force, pairs, strict=True):
            if before.solution is not None and before.solution.disturbance is not None:
                row += before.solution.disturbance.forces
            if before.springs is not None and after.springs is not None:
                row += 0.5 * (before.springs + after.springs)  # exact for springs
            row *= self._model.difference(before.state.q, after.state.q)
            powers = zip(before.powers, after.last_powers, strict=True)
            known += [0.5 * after.gap * (start + end) for start, end in powers]
        return np.append(force, known)

    def _finish_span(self, state: RobotState, dynamics: Dynamics) -> AuditReport:
        settings, pairs, self._steps = self._settings, list(pairwise(self._steps)), self._steps[-1:]
        lasted = sum(after.gap for _, after in pairs)
        work, stored, self._stored = self._work(pairs), self._stored, self._mechanical_energy(dynamics)
        share = lasted / (settings.time_constant + lasted)
        self._energy += share * ((self._stored - stored - work.sum()) / lasted - self._energy)
        self._throughput += share * (np.abs(work).sum() / lasted - self._throughput)
        predicted = sum(after.gap for before, after in pairs if before.solution is not None)
        if predicted > 0.0:
            share = predicted / (settings.time_constant + predicted)
            velocity, com_velocity = np.zeros(self._model.nv), np.zeros(3)  # unpredicted changes
            for before, after in pairs:
                if before.solution is not None:
                    velocity += after.state.v - before.state.v - after.gap * before.solution.v_dot
                    com_velocity += after.com_velocity - before.com_velocity - after.gap * before.com_acceleration
            if self._model.floating_base:  # not of a fixed base
                self._force += share * (self._mass * com_velocity / predicted - self._force)
            self._torques += share * (dynamics.M @ velocity / predicted - self._torques)
        force, torques = frozen(self._force), freeze(self._to_joints @ self._torques)
        too_large = {
            "UNMODELLED_FORCE": sum_of_squares(force) > self._largest_force**2,
            "UNMODELLED_TORQUE": bool((np.abs(torques) > self._largest_torques).any()),
            "ENERGY_RESIDUAL": abs(self._energy) > settings.energy * max(self._throughput, settings.power),
        }
        now, warnings = state.stamp * 1.0e-9, []
        for name, is_too_large in too_large.items():
            if not is_too_large:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now - lasted) >= settings.patience:
                warnings.append(f"{name}: {self._describe(name, force, torques)}")
        return AuditReport(self._energy, self._throughput, force, torques, tuple(warnings))

    def _describe(self, finding: str, force: Array, torques: Array) -> str:
        if finding == "UNMODELLED_FORCE":
            size = float(np.linalg.norm(force))
            direction = ", ".join(f"{part / size:.2f}" for part in force)
            return (
                f"{size:.2f} N on the centre of mass along [{direction}], {100.0 * size / self._weight:.2f} % of the "
                "weight: a push, a wrong mass, or a wrong contact"
            )
        if finding == "UNMODELLED_TORQUE":
            worst = int((np.abs(torques) / self._largest_torques).argmax())
            torque = f"{torques.item(worst):.3g} N·m at {self._model.joints[worst]}"
            return f"{torque}: torque not applied as sent, friction, or a wrong inertia"
        return f"{self._energy:.3g} W of {self._throughput:.3g} W: a wrong torque, friction, or a wrong mass"


def joint_efforts(model: RobotModel) -> Array:
    """Return the largest torque of each joint, (nj,) in N·m; of undriven joints the median."""
    efforts = np.asarray(model.effort_limits @ np.abs(model.actuation.ratios))
    driven = efforts > 0.0
    return np.where(driven, efforts, np.median(efforts[driven]))


def _powers(solution: Solution, dynamics: Dynamics) -> list[float]:
    wrenches = solution.external_wrenches
    return [float(dynamics.external_force(frame, wrench) @ dynamics.v) for frame, wrench in wrenches.items()]
