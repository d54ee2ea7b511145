"""Particles connected by rigid rods, with contacts (33) (section 4.2.1; S9)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array
from wbc_controller.mechanics.gauss import ConstrainedMotion, admissible_directions, gauss
from wbc_controller.records import Array

ConstrainedRows = tuple[Array, Array]  # A, (k, 3n), and b, (k,), of equation (30) for particles


@dataclass(frozen=True)
class Rod:
    """Massless rigid rod between two particles, or between a particle and the world."""

    first: int  # index of a particle
    second: int | Array  # index of another particle, or point in the world, (3,) in m
    length: float  # m


@dataclass(frozen=True)
class ParticleSystem:
    """Point masses and rods.

    Raises:
        ConfigurationError: if a mass or length is not positive, or a particle is unknown.
    """

    masses: Array  # (n,) in kg
    rods: Sequence[Rod]  # structure
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))  # (3,) in m/s²

    def __post_init__(self) -> None:
        n = len(self.masses)
        if not np.all(np.asarray(self.masses) > 0.0):
            raise ConfigurationError(f"masses = {np.asarray(self.masses).tolist()} kg: must be positive")
        for rod in self.rods:
            ends = [rod.first, rod.second] if isinstance(rod.second, int) else [rod.first]
            for end in ends:
                if not 0 <= end < n:
                    raise ConfigurationError(f"unknown particle {end} of a rod; valid: 0 to {n - 1}")
            if not rod.length > 0.0:
                raise ConfigurationError(
                    f"length = {rod.length} m of the rod at particle {rod.first}: must be positive"
                )


def particle_mass_matrix(system: ParticleSystem) -> Array:
    """Return the diagonal mass matrix of equations (1) and (33), (3n, 3n) in kg."""
    return np.diag(np.repeat(np.asarray(system.masses, dtype=np.float64), 3))


def rod_constraints(
    system: ParticleSystem, x: Array, x_dot: Array, *, time_constant: float = np.inf
) -> ConstrainedRows:
    """Return A_s, (rods, 3n), and b_s, (rods,), of (33), from g = ½(‖d‖² - length²) = 0 for the vector d of each rod.

    ġ = dᵀḋ and g̈ = dᵀd̈ + ḋᵀḋ, in the form (30).

    Args:
        time_constant: time constant of Baumgarte's stabilization, s.

    Raises:
        InputRefused: if an array is invalid.
    """
    n = len(system.masses)
    x, x_dot = as_array("x", x, (n, 3)), as_array("x_dot", x_dot, (n, 3))
    A, b = np.zeros((len(system.rods), n, 3)), np.zeros(len(system.rods))
    rate = 1.0 / time_constant
    for row, rod in enumerate(system.rods):
        if isinstance(rod.second, int):
            d, d_dot = x[rod.first] - x[rod.second], x_dot[rod.first] - x_dot[rod.second]
            A[row, rod.second] = -d
        else:
            d, d_dot = x[rod.first] - np.asarray(rod.second), x_dot[rod.first]
        A[row, rod.first] = d
        b[row] = -d_dot @ d_dot - 2.0 * rate * (d @ d_dot) - 0.5 * rate**2 * (d @ d - rod.length**2)
    return A.reshape(len(system.rods), 3 * n), b


def _free_acceleration(system: ParticleSystem, forces: Array | None) -> Array:
    """Return ẍᵤ of gravity and other forces, (3n,) in m/s²; equations (1) and (3)."""
    n = len(system.masses)
    others = np.zeros((n, 3)) if forces is None else as_array("forces", forces, (n, 3))
    return np.ravel(system.gravity + others / np.asarray(system.masses)[:, None])


def solve_in_one_stage(
    system: ParticleSystem, structure: ConstrainedRows, contact: ConstrainedRows, forces: Array | None = None
) -> ConstrainedMotion:
    """Return the accelerations of all particles, (3n,) in m/s², with structure and contact at once (33).

    The multipliers of the structure come first.
    """
    A, b = np.vstack([structure[0], contact[0]]), np.concatenate([structure[1], contact[1]])
    return gauss(particle_mass_matrix(system), _free_acceleration(system, forces), A, b)


@dataclass(frozen=True, slots=True)
class ReducedProblem:
    """Problem (33) with eliminated structure: (31) in d coordinates a, ẍ = particular + basis · a."""

    basis: Array  # (3n, d), as ∂φ/∂q in (15) and (17)
    particular: Array  # acceleration that satisfies the structure, (3n,)
    M: Array  # reduced mass matrix, (d, d)
    a_u: Array  # reduced acceleration without contact, (d,)


def reduce_structure(
    system: ParticleSystem, structure: ConstrainedRows, forces: Array | None = None, *, basis: Array | None = None
) -> ReducedProblem:
    """Eliminate A_s ẍ = b_s from (33), the first stage of section 4.2.1.

    With basis ∂φ/∂q of generalized coordinates, M = (∂φ/∂q)ᵀ M_x (∂φ/∂q) is their mass matrix, in kg for coordinates
    in m.

    Args:
        basis: (3n, d) with A_s basis = 0; by default orthonormal.

    Raises:
        ConfigurationError: if the basis violates the structure.
    """
    A, b = structure
    if basis is None:
        basis = admissible_directions(A)
    elif not np.max(np.abs(A @ basis), initial=0.0) <= 1.0e-8 * max(1.0, float(np.max(np.abs(basis)))):
        raise ConfigurationError("the basis violates the structure: A_s basis must be zero")
    M_x = particle_mass_matrix(system)
    # Any acceleration that satisfies the structure; here by Gauss with unit metric.
    particular = gauss(np.eye(len(M_x)), np.zeros(len(M_x)), A, b).v_dot
    M = basis.T @ M_x @ basis
    a_u = np.linalg.solve(M, basis.T @ M_x @ (_free_acceleration(system, forces) - particular))
    return ReducedProblem(basis, particular, M, a_u)


def solve_in_two_stages(
    system: ParticleSystem, structure: ConstrainedRows, contact: ConstrainedRows, forces: Array | None = None
) -> ConstrainedMotion:
    """Return the accelerations of all particles, (3n,) in m/s², by `reduce_structure` and (31) (section 4.2.1).

    The other fields belong to the contacts, in reduced coordinates.
    """
    reduced = reduce_structure(system, structure, forces)
    A, b = contact
    motion = gauss(reduced.M, reduced.a_u, A @ reduced.basis, b - A @ reduced.particular)
    return replace(motion, v_dot=reduced.particular + reduced.basis @ motion.v_dot)
