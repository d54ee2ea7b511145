"""Energies, the Hamiltonian and the power balance (section 3.2; S6)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.errors import InputRefused
from wbc_controller.mechanics.checks import as_array
from wbc_controller.mechanics.equations_of_motion import inverse_dynamics, mass_matrix
from wbc_controller.mechanics.external import ExternalWrench, generalized_force
from wbc_controller.records import Array, RobotState


def kinetic_energy(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> float:
    """Return the kinetic energy T = ½ vᵀM v of equation (5), J, with rotors."""
    # pinocchio.computeKineticEnergy (4.1) omits the rotors of joints with a slanted axis.
    return float(0.5 * v @ mass_matrix(model, q, data=data) @ v)


def potential_energy(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> float:
    """Return the potential energy V = -Σ mᵢ gᵀxᵢ of equations (2) and (3), J; g points down, unlike the note's."""
    return float(pin.computePotentialEnergy(model, data or model.createData(), q))


def lagrangian(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> float:
    """Return the Lagrangian L = T - V of equation (6), J."""
    return kinetic_energy(model, q, v, data=data) - potential_energy(model, q, data=data)


def hamiltonian(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> float:
    """Return the Hamiltonian H = pᵀv - L = T + V of equation (29), J."""
    return kinetic_energy(model, q, v, data=data) + potential_energy(model, q, data=data)


def hamiltonian_rate(model: pin.Model, q: Array, v: Array, v_dot: Array, *, data: pin.Data | None = None) -> float:
    """Return dH/dt = vᵀ(M v̇ + h) of equation (29), W = J/s."""
    return float(v @ inverse_dynamics(model, q, v, v_dot, data=data))


def power(v: Array, force: Array) -> float:
    """Return the power fᵀv of a generalized force, (nv,), W; τᵀS v for joint torques (section 3.2; S6)."""
    return float(force @ v)


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Energy balance between two states (equation (29))."""

    rate: float  # mean dH/dt, W
    supplied: float  # mean power of torques and external wrenches, W
    throughput: float  # sum of their absolute mean powers, W, the scale of the residual

    @property
    def residual(self) -> float:
        """Unexplained power, W."""
        return self.rate - self.supplied


def duration(before: RobotState, after: RobotState) -> float:
    """Return the time between two states, s, or raise `InputRefused` if it is not positive."""
    seconds = (after.stamp - before.stamp) * 1.0e-9
    if not seconds > 0.0:
        raise InputRefused(f"stamp {after.stamp} ns of the second state is not after {before.stamp} ns of the first")
    return seconds


def energy_residual(
    model: pin.Model, before: RobotState, after: RobotState, force: Array, wrenches: Sequence[ExternalWrench] = (), *,
    data: pin.Data | None = None,
) -> EnergyBalance:  # fmt: skip
    """Return the balance dH/dt = τᵀS v + external power (equation (29), S6) between two states.

    Work of constant torques, f · (q₁ ⊖ q₀), is exact; work of constant wrenches is second-order accurate.

    Args:
        force: constant generalized force Sᵀτ, (nv,) in N and N·m.
        wrenches: all other forces that do work.

    Raises:
        InputRefused: if the second state is not later, or the force is invalid.
    """
    seconds = duration(before, after)
    data = data or model.createData()
    applied = as_array("force", force, (model.nv,))
    work = applied * np.asarray(pin.difference(model, before.q, after.q))
    rate = hamiltonian(model, after.q, after.v, data=data) - hamiltonian(model, before.q, before.v, data=data)
    external = [
        0.5 * seconds * sum(power(s.v, generalized_force(model, s.q, [w], data=data)) for s in (before, after))
        for w in wrenches
    ]
    return EnergyBalance(
        rate=rate / seconds,
        supplied=float(work.sum() + sum(external)) / seconds,
        throughput=float(np.abs(work).sum() + sum(abs(w) for w in external)) / seconds,
    )
