"""Compensation of known joint friction, dry and viscous.

The torque of dry friction c and viscous friction b is

    -c tanh(w / w₀) - b v,

where w is the intended velocity. The measured velocity v does not suffice, as a joint held by friction does not turn.
Therefore w follows v, ahead of it by the acceleration of the QP,

    ẇ = v̇_QP + (v - w) / T_w.

With a correct model, w = v. If a joint sticks, w grows to T_w v̇_QP within T_w, and dry friction is compensated before
the joint turns. w₀ makes the change of sign smooth (Armstrong-Hélouvry, Dupont, Canudas de Wit, "A
survey of models, analysis tools and compensation methods for the control of machines with friction", Automatica 1994).

Near rest the torque has the slope c / w₀ in w. If the real friction is smaller, this accelerates a joint of inertia I
at the rate c / (w₀ I), which must stay below the bandwidth of the sampled loop: w₀ is at least c τ / I. I is the
effective inertia on the active contacts, 1 / (M⁻¹ - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J M⁻¹)ⱼⱼ. Light joints, such as wrists,
therefore get less compensation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbc_controller.estimation.projection import mobility
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Least w₀, rad/s or m/s.
_SMOOTH = 0.02
#: τ, s.
_LOOP_TIME = 0.002
#: Time between two computations of the inertias, s.
_INERTIA_PERIOD = 0.1
#: T_w, s.
_AHEAD = 0.2


class FrictionCompensation:
    """Friction torques of the joints at their intended velocities.

    Attributes:
        forces: generalized forces of friction, (nv,) in N·m, N.
    """

    STATE_FIELDS = ("forces", "_intended", "_smooth", "_contacts", "_age")

    def __init__(self, model: RobotModel, dry: Mapping[str, float], viscous: Mapping[str, float]) -> None:
        """Begin at rest.

        Args:
            model: the robot's model.
            dry: c by joint, N·m.
            viscous: b by joint, N·m·s/rad.
        """
        self._dry, self._viscous = np.zeros(model.nv), np.zeros(model.nv)
        for joint, index in zip(model.joints, model.v_index, strict=True):
            self._dry[index], self._viscous[index] = dry.get(joint, 0.0), viscous.get(joint, 0.0)
        self.restart()

    def restart(self) -> None:
        """Forget the intended velocities."""
        self.forces = np.zeros(len(self._dry))
        self._intended = np.zeros(len(self._dry))
        self._smooth = np.full(len(self._dry), np.inf)
        self._contacts: tuple[str, ...] = ()
        self._age = np.inf

    def update(self, M: Array, J: Array, contacts: tuple[str, ...], v: Array, gap: float, change: Array | None) -> None:
        """Update the torques for a new state.

        Args:
            M: mass matrix, (nv, nv).
            J: Jacobian of the active contacts, (k, nv).
            contacts: their names.
            v: measured velocity, (nv,).
            gap: time since the previous state, s.
            change: predicted change of the velocity since then, (nv,); None if unknown.
        """
        if change is None:
            self._intended = np.array(v)
        else:
            ahead = self._intended + change
            self._intended = ahead + min(1.0, gap / _AHEAD) * (v - ahead)
        self._age += gap
        if contacts != self._contacts or self._age > _INERTIA_PERIOD:
            self._contacts, self._age = contacts, 0.0
            self._smooth = np.maximum(_SMOOTH, _LOOP_TIME * self._dry * mobility(M, J))
        self.forces = -self._dry * np.tanh(self._intended / self._smooth) - self._viscous * v
