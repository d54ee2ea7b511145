"""Compensation of known joint friction.

The torque is

    -c tanh(w / w₀) - b v,        ẇ = v̇_QP + (v - w) / T_w.

The intended velocity w of a stuck joint grows to T_w v̇_QP, which compensates dry friction before the joint moves;
otherwise w = v (Armstrong-Hélouvry, Dupont, Canudas de Wit, "A survey of models, analysis tools and compensation
methods for the control of machines with friction", Automatica 1994).

The rate c / (w₀ I) must stay below the loop's bandwidth if c is overestimated: w₀ ≥ c τ / I, with the effective inertia
I = 1 / (M⁻¹ - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J M⁻¹)ⱼⱼ on the active contacts.
"""

from collections.abc import Mapping

import numpy as np

from wbc_controller.estimation.projection import mobility
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_SMOOTH = 0.02  # least w₀, rad/s or m/s
_LOOP_TIME = 0.002  # τ, s
_INERTIA_PERIOD = 0.1  # time between two computations of the inertias, s
_LEAD_TIME = 0.2  # t_w, s


class FrictionCompensation:
    """Friction torques of the joints: `forces`, (nv,) in N·m, N."""

    STATE_FIELDS = ("forces", "_intended", "_smooth", "_contacts", "_age")

    def __init__(self, model: RobotModel, dry: Mapping[str, float], viscous: Mapping[str, float]) -> None:
        """Start at rest; dry c in N·m and viscous b in N·m·s/rad."""
        self._dry, self._viscous = np.zeros(model.nv), np.zeros(model.nv)
        for joint, index in zip(model.joints, model.v_index, strict=True):
            self._dry[index], self._viscous[index] = dry.get(joint, 0.0), viscous.get(joint, 0.0)
        self.restart()

    def restart(self) -> None:
        """Reset the intended velocities."""
        self.forces, self._intended = np.zeros(len(self._dry)), np.zeros(len(self._dry))
        self._smooth = np.full(len(self._dry), np.inf)
        self._contacts: tuple[str, ...] = ()
        self._age = np.inf

    def update(self, M: Array, J: Array, contacts: tuple[str, ...], v: Array, gap: float, change: Array | None) -> None:
        """Update the torques; M, J, contacts and gap as for `DisturbanceObserver.update`.

        v is measured, `change` its predicted change since the previous state, (nv,), or None.
        """
        if change is None:
            self._intended = np.array(v)
        else:
            ahead = self._intended + change
            self._intended = ahead + min(1.0, gap / _LEAD_TIME) * (v - ahead)
        self._age += gap
        if contacts != self._contacts or self._age > _INERTIA_PERIOD:
            self._contacts, self._age = contacts, 0.0
            self._smooth = np.maximum(_SMOOTH, _LOOP_TIME * self._dry * mobility(M, J))
        self.forces = -self._dry * np.tanh(self._intended / self._smooth) - self._viscous * v
