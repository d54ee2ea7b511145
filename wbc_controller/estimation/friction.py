"""Known friction of the joints: dry and viscous, as torques that act beside those of the model.

A joint with dry friction c and viscous friction b lacks the torque

    -c tanh(w / w₀) - b v,

where w is the velocity at which it is meant to turn. The measured velocity v is not enough: a joint that friction holds
does not turn at all. So w follows v, and runs ahead of it as the program wants,

    ẇ = v̇_program + (v - w) / T_w.

Where the model is right, w = v. Where a joint sticks, it grows to T_w v̇_program within T_w, and dry friction is
compensated before the joint turns. w₀ makes the change of sign smooth (Armstrong-Hélouvry, Dupont, Canudas de Wit, "A
survey of models, analysis tools and compensation methods for the control of machines with friction", Automatica 1994).

Near rest the torque has the slope c / w₀ in w. Where friction is less than was said, that drives a joint of inertia I
with a rate of c / (w₀ I), which a sampled loop has to bear: w₀ is at least c τ / I, where I is what the joint moves on
the contacts that hold, 1 / (M⁻¹ - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J M⁻¹)ⱼⱼ. So light joints, such as wrists, get less of it.
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
_BEARABLE = 0.002
#: Time after which the inertias are computed anew, s.
_RENEWED = 0.1
#: T_w, s.
_AHEAD = 0.2


class FrictionCompensation:
    """Friction torques of the joints at the velocities at which they are meant to turn.

    Attributes:
        forces: generalized forces of friction, (nv,) in N·m, N.
    """

    MEMORY = ("forces", "_meant", "_smooth", "_contacts", "_age")

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
        """Forget where the joints were meant to go."""
        self.forces = np.zeros(len(self._dry))
        self._meant = np.zeros(len(self._dry))
        self._smooth = np.full(len(self._dry), np.inf)
        self._contacts: tuple[str, ...] = ()
        self._age = np.inf

    def look(self, M: Array, J: Array, contacts: tuple[str, ...], v: Array, gap: float, wanted: Array | None) -> None:
        """Take a new state.

        Args:
            M: mass matrix, (nv, nv).
            J: Jacobian of the contacts that hold, (k, nv).
            contacts: their names.
            v: its velocity, (nv,).
            gap: time since the state before, s.
            wanted: by how much the velocity was meant to change since, (nv,); None where that is not known.
        """
        if wanted is None:
            self._meant = np.array(v)
        else:
            ahead = self._meant + wanted
            self._meant = ahead + min(1.0, gap / _AHEAD) * (v - ahead)
        self._age += gap
        if contacts != self._contacts or self._age > _RENEWED:
            self._contacts, self._age = contacts, 0.0
            self._smooth = np.maximum(_SMOOTH, _BEARABLE * self._dry * mobility(M, J))
        self.forces = -self._dry * np.tanh(self._meant / self._smooth) - self._viscous * v
