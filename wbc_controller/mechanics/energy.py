"""Energies, the Hamiltonian and the power balance (section 3.2; S6)."""

from __future__ import annotations

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
    """Kinetic energy T = ½ vᵀM v of equation (5) in generalized coordinates, J, including the rotors.

    `pinocchio.computeKineticEnergy` is not used: in 4.1 it omits the rotors of joints with a slanted axis.
    """
    return float(0.5 * v @ mass_matrix(model, q, data=data) @ v)


def potential_energy(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> float:
    """Potential energy V = -Σ mᵢ gᵀxᵢ of equations (2) and (3), J; zero if the centre of mass is level with the origin.

    ``model.gravity`` points down, so the sign is the opposite of the note's g.
    """
    return float(pin.computePotentialEnergy(model, data if data is not None else model.createData(), q))


def lagrangian(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> float:
    """Lagrangian L = T - V of equation (6), J, from which (7) derives the equations of motion."""
    return kinetic_energy(model, q, v, data=data) - potential_energy(model, q, data=data)


def hamiltonian(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> float:
    """Hamiltonian H = pᵀv - L of equation (29), J, which is T + V for a mechanical system."""
    return kinetic_energy(model, q, v, data=data) + potential_energy(model, q, data=data)


def hamiltonian_rate(model: pin.Model, q: Array, v: Array, v_dot: Array, *, data: pin.Data | None = None) -> float:
    """Rate of change dH/dt of equation (29) along a motion, W: vᵀ(M v̇ + h), since gyroscopic forces do no work."""
    return float(v @ inverse_dynamics(model, q, v, v_dot, data=data))


def power(v: Array, force: Array) -> float:
    """Power of a generalized force, fᵀv, W; for the joint torques τᵀS v (section 3.2; S6).

    If no other force acts, dH/dt of equation (29) equals this power: constraint forces do no work (equation (19)),
    unless the constraint itself moves.

    Args:
        force: generalized force, (nv,) in N and N·m.
    """
    return float(force @ v)


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Energy balance between two states (equation (29)).

    Attributes:
        rate: mean dH/dt, W.
        supplied: mean power of the torques and of the external wrenches, W.
        throughput: sum of the absolute mean powers of all torques and wrenches, W: the scale for the residual.
    """

    rate: float
    supplied: float
    throughput: float

    @property
    def residual(self) -> float:
        """Power that no known force accounts for, W; zero if model and measurements agree."""
        return self.rate - self.supplied


def duration(before: RobotState, after: RobotState) -> float:
    """Time between two states, s, for the balances of equations (26) and (29).

    Raises:
        InputRefused: where the second state is not later than the first.
    """
    seconds = (after.stamp - before.stamp) * 1.0e-9
    if not seconds > 0.0:
        raise InputRefused(f"a state of {after.stamp} ns follows one of {before.stamp} ns; expected a later stamp")
    return seconds


def energy_residual(
    model: pin.Model,
    before: RobotState,
    after: RobotState,
    force: Array,
    wrenches: Sequence[ExternalWrench] = (),
    *,
    data: pin.Data | None = None,
) -> EnergyBalance:
    """Check dH/dt = τᵀS v + external power (equation (29), S6) between two consecutive states.

    For torques that are constant between the states their work, f · (q₁ ⊖ q₀), is exact. For wrenches that are constant
    in their own axes the work is accurate to second order in the time between the states.

    Args:
        force: generalized force Sᵀτ between the states, (nv,) in N and N·m.
        wrenches: all other forces between the states, contacts included; forces that do no work may be omitted.

    Raises:
        InputRefused: if the second state is not later, or the force has another shape or is not finite.
        ConfigurationError: if a wrench's frame is unknown.
    """
    seconds = duration(before, after)
    data = data if data is not None else model.createData()
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
