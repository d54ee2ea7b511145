"""Generalized and centroidal momentum, momentum balance (section 3.1; S5)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.mechanics.energy import duration
from wbc_controller.mechanics.equations_of_motion import mass_matrix
from wbc_controller.mechanics.external import ExternalWrench, world_wrench
from wbc_controller.records import Array, RobotState


def generalized_momentum(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> Array:
    """Return the generalized momentum p = ∂L/∂v = M v of equations (25) and (26), (nv,) in N·s and N·m·s."""
    return np.asarray(mass_matrix(model, q, data=data) @ v)


def centroidal_momentum(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> Array:
    """Return linear and angular momentum about the centre of mass, (28), (6,) in N·s and N·m·s, world axes.

    Without rotors. Orin, Goswami, Lee, "Centroidal dynamics of a humanoid robot" (2013).
    """
    return np.array(pin.computeCentroidalMomentum(model, data or model.createData(), q, v).vector)


def centroidal_momentum_rate(
    model: pin.Model, q: Array, v: Array, v_dot: Array, *, data: pin.Data | None = None
) -> Array:
    """Return the time derivative of `centroidal_momentum`, ṗ of equation (26), (6,) in N and N·m."""
    return np.array(pin.computeCentroidalMomentumTimeVariation(model, data or model.createData(), q, v, v_dot).vector)


def centroidal_wrench(
    model: pin.Model, q: Array, wrenches: Sequence[ExternalWrench] = (), *, data: pin.Data | None = None
) -> Array:
    """Return the wrench of gravity and external forces about the centre of mass, (6,) in N and N·m, world axes (S5).

    It equals `centroidal_momentum_rate`; internal forces (27) cancel.
    """
    data = data or model.createData()
    total = world_wrench(model, q, wrenches, data=data)
    com = np.array(pin.centerOfMass(model, data, q))
    total[3:] -= np.cross(com, total[:3])
    total[:3] += pin.computeTotalMass(model) * np.array(model.gravity.linear)
    return total


@dataclass(frozen=True, slots=True)
class MomentumBalance:
    """Balance of centroidal momentum between two states (equation (26))."""

    rate: Array  # mean rate of change, (6,) in N and N·m, world axes
    supplied: Array  # mean wrench of gravity and external forces, (6,) in N and N·m

    @property
    def residual(self) -> Array:
        """Unexplained wrench, (6,) in N and N·m."""
        return self.rate - self.supplied


def momentum_residual(
    model: pin.Model, before: RobotState, after: RobotState, wrenches: Sequence[ExternalWrench] = (), *,
    data: pin.Data | None = None,
) -> MomentumBalance:  # fmt: skip
    """Return the balance of centroidal momentum between two states (equation (26), S5), N and N·m.

    Detects wrong masses, contact forces and unknown pushes; `energy_residual` detects wrong torques. Wrenches are
    constant in their axes, and include the support force of a fixed base.

    Raises:
        InputRefused: if the second state is not later.
    """
    seconds = duration(before, after)
    data = data or model.createData()
    states = before, after
    first, last = (centroidal_momentum(model, state.q, state.v, data=data) for state in states)
    supplied = [centroidal_wrench(model, state.q, wrenches, data=data) for state in states]
    return MomentumBalance(rate=(last - first) / seconds, supplied=np.mean(supplied, axis=0))
