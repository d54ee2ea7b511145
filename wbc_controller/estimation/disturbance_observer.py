"""Disturbance observer: slow forces outside the model.

With d, (nv,), the QP has the equations of motion M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + d. The prediction error corrects d

    ḋ = Nᵀ M (v̇_measured - v̇_predicted) / T - d / (25 T),      N = I - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J,

as on robot arms (De Luca, Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005).
Nᵀ (`projection`) removes forces that move nothing. Against windup, d is stored without bounds, and Nᵀ times the clamped
part is subtracted from the residual.
"""

from dataclasses import dataclass

import numpy as np

from wbc_controller.estimation.projection import split_force
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, frozen

_LEAK = 25.0  # time constant of the decay, in T; a constant disturbance is estimated to 24/25
_LEVER = 0.1  # lever of the largest moment on the base, m
_SUM_TIME = 0.01  # time over which residuals are summed before the projection, s
_FADE_TIME = 0.3  # time constant of the decay after the observer is switched off, s
_NEGLIGIBLE = 1.0e-4  # size below which a decaying estimate becomes zero, as a share of the largest size


@dataclass(frozen=True, slots=True)
class DisturbanceLimits:
    """Time constant T, s; largest share of joint torques and weight; False for `on` lets d decay to zero."""

    time_constant: float
    share: float
    on: bool = True


class DisturbanceObserver:
    """Estimate of the generalized forces outside the model.

    `forces` is d, (nv,); `at_bound` names joints, and ``base``, with saturated components; `missing_contact_forces` is
    the mean Δf, (k,), with its duration, s, or None.
    """

    STATE_FIELDS = ("forces", "at_bound", "_unbounded", "_contacts", "_sum", "_time", "_all_predicted")

    def __init__(self, model: RobotModel, limits: DisturbanceLimits) -> None:
        self.limits = limits
        self._scale = np.zeros(model.nv)  # bound at a share of 1
        if model.floating_base:
            weight = model.mass * model.gravity
            self._scale[:3], self._scale[3:6] = weight, _LEVER * weight
        self._scale[model.v_places] = np.abs(model.actuation.ratios).T @ model.effort_limits
        self._names = np.full(model.nv, "base", dtype=object)
        self._names[model.v_places] = model.joints
        self.restart()

    def restart(self) -> None:
        """Reset to zero."""
        self.forces = self._unbounded = frozen(np.zeros(len(self._scale)))
        self.at_bound: tuple[str, ...] = ()
        self.missing_contact_forces: tuple[Array, float] | None = None
        self._start_sum(())

    def _start_sum(self, contacts: tuple[str, ...]) -> None:
        self._contacts, self._sum, self._time = contacts, np.zeros(len(self._scale)), 0.0
        self._all_predicted = True

    @property
    def is_idle(self) -> bool:
        """True if the estimate is zero and stays zero."""
        return not self.limits.on and not np.count_nonzero(self.forces)

    def update(self, M: Array, J: Array, contacts: tuple[str, ...], gap: float, residual: Array | None) -> None:
        """Add the residual of a prediction; update d at the end of a sum.

        M, (nv, nv), and the Jacobian J of the active `contacts`, (k, nv), are from the previous state, `gap` s ago.
        `residual` is the unpredicted M Δv, (nv,) in N·s and N·m·s; None without a prediction.
        """
        self.missing_contact_forces = None
        if contacts != self._contacts:
            self._start_sum(contacts)
        if residual is not None:
            self._sum = self._sum + residual
        else:
            self._all_predicted = False
        self._time += gap
        if self._time < _SUM_TIME:
            return
        if self.limits.on:
            self._correct(M, J)
        else:
            forces = self.forces * max(0.0, 1.0 - self._time / _FADE_TIME)
            lasting = (np.abs(forces) > _NEGLIGIBLE * self._scale).any()
            self.forces = self._unbounded = frozen(forces if lasting else np.zeros(len(forces)))
            self.at_bound = ()
        self._start_sum(contacts)

    def _correct(self, M: Array, J: Array) -> None:
        T, largest = self.limits.time_constant, self.limits.share * self._scale
        residual, contact_impulse = split_force(M, J, self._sum)
        if self._all_predicted:
            self.missing_contact_forces = contact_impulse / self._time, self._time
        before = self._unbounded
        clamped = before - self.forces
        if clamped.any():
            residual = residual - split_force(M, J, self._time * clamped)[0]
        unbounded = before + (residual - self._time / _LEAK * before) / max(T, self._time)
        self.at_bound = tuple(dict.fromkeys(self._names[(np.abs(unbounded) > largest) & (largest > 0.0)].tolist()))
        self.forces, self._unbounded = frozen(np.clip(unbounded, -largest, largest)), frozen(unbounded)
