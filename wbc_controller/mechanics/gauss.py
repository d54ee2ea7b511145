"""Gauss's principle of least constraint (section 4.1, equations (30)–(32); S3, S8), for any M, A and b.

This module is plain linear algebra: `constraints` makes A and b, and `contact_dynamics` applies the result to
mechanisms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from wbc_controller.errors import InputRefused, NoSolution
from wbc_controller.mechanics.checks import as_array
from wbc_controller.records import Array

#: Singular values of A below this share of the largest count as zero: the rows are then redundant.
RANK_TOLERANCE = 1.0e-10
#: Singular values of A below this, in SI units, count as zero too: rounding of a constraint that does not depend on
#: the motion (a link on itself).
ZERO = 1.0e-12
#: Largest part of b outside the range of A, relative to the size of b.
CONSISTENCY_TOLERANCE = 1.0e-6


@dataclass(frozen=True, slots=True)
class ConstrainedMotion:
    """The solution of Gauss's problem (31).

    Attributes:
        v_dot: constrained acceleration v̇*, (nv,).
        multipliers: λ of (32), (k,); for a contact the force of the environment on the robot, in N or N·m. If λ is not
            unique, the one of least norm.
        constraint_force: f_c = Aᵀλ, (nv,) in N and N·m.
        push: multipliers μ of the inequalities, (m,), all ≥ 0; empty where there are none.
        push_force: generalized force Cᵀμ of the inequalities, (nv,) in N and N·m.
        rank: number of independent rows of A.
        condition: condition number of A: its largest singular value over the smallest that does not count as zero.
    """

    v_dot: Array
    multipliers: Array
    constraint_force: Array
    push: Array
    push_force: Array
    rank: int
    condition: float


@dataclass(frozen=True, slots=True)
class _Decomposition:
    """A = U diag(s) Vᵀ, and N, whose columns span the null space of A."""

    U: Array
    s: Array
    V: Array
    N: Array

    @property
    def condition(self) -> float:
        return float(self.s[0] / self.s[-1]) if len(self.s) else 1.0


def _decompose(A: Array) -> _Decomposition:
    n = A.shape[1]
    if not A.shape[0]:
        return _Decomposition(np.zeros((0, 0)), np.zeros(0), np.zeros((n, 0)), np.eye(n))
    U, s, Vt = np.linalg.svd(A)
    rank = int(np.sum(s > max(RANK_TOLERANCE * s[0], ZERO)))
    return _Decomposition(U[:, :rank], s[:rank], Vt[:rank].T, Vt[rank:].T)


def _check(M: Array, v_dot_u: Array, A: Array, b: Array) -> tuple[Array, Array, Array, Array]:
    acceleration = np.asarray(v_dot_u, dtype=np.float64)
    n = acceleration.size
    rows = np.asarray(b, dtype=np.float64).size
    return (
        as_array("M", M, (n, n)),
        as_array("v_dot_u", acceleration, (n,)),
        as_array("A", A, (rows, n)),
        as_array("b", b, (rows,)),
    )


def _consistent(A: Array, b: Array, v_dot: Array) -> None:
    miss = np.abs(A @ v_dot - b)
    size = max(1.0, float(np.max(np.abs(b), initial=0.0)))
    if not np.max(miss, initial=0.0) <= CONSISTENCY_TOLERANCE * size:
        row = int(np.argmax(miss))
        raise NoSolution(
            f"the constraints A v̇ = b contradict each other: row {row} asks for {b[row]:.6g} and gets "
            f"{A[row] @ v_dot:.6g} at best; repeated constraints must agree to {CONSISTENCY_TOLERANCE:.0e} of b",
            "inconsistent",
            (A, b),
        )


def _multipliers(split: _Decomposition, force: Array) -> tuple[Array, Array]:
    """Least-norm λ with Aᵀλ = force, and Aᵀλ, computed along V because a product with λ amplifies rounding errors."""
    along = split.V.T @ force
    return split.U @ (along / split.s), split.V @ along


def gauss(M: Array, v_dot_u: Array, A: Array, b: Array) -> ConstrainedMotion:
    """Solve Gauss's problem (31), v̇* = argmin ½‖v̇ - v̇ᵤ‖²_M subject to A v̇ = b, through its conditions (32).

    The conditions are M(v̇ - v̇ᵤ) - Aᵀλ = 0 and A v̇ = b. With redundant rows of A this system is singular in λ only:
    the acceleration, (nv,) in m/s² and rad/s², and Aᵀλ are unique. It is solved in the null space of A (N, with
    A N = 0), where no matrix to be inverted can be singular: v̇ = A⁺b + N z, (NᵀM N) z = NᵀM(v̇ᵤ - A⁺b), and λ is the
    least-norm solution of Aᵀλ = M(v̇ - v̇ᵤ).

    Raises:
        InputRefused: if shapes do not fit, a value is not finite, or M is not positive definite.
        NoSolution: if the constraints contradict each other; carries (A, b).
    """
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    split = _decompose(A)
    particular = split.V @ ((split.U.T @ b) / split.s)
    free = split.N.T @ M
    try:
        np.linalg.cholesky(free @ split.N)
    except np.linalg.LinAlgError as error:
        raise InputRefused(f"the mass matrix is not positive definite on the free directions: {error}") from error
    z = np.linalg.solve(free @ split.N, free @ (v_dot_u - particular))
    v_dot = particular + split.N @ z
    _consistent(A, b, v_dot)
    multipliers, constraint_force = _multipliers(split, M @ (v_dot - v_dot_u))
    return ConstrainedMotion(
        v_dot=v_dot,
        multipliers=multipliers,
        constraint_force=constraint_force,
        push=np.zeros(0),
        push_force=np.zeros(len(v_dot)),
        rank=len(split.s),
        condition=split.condition,
    )


def udwadia_kalaba(M: Array, v_dot_u: Array, A: Array, b: Array) -> Array:
    """Explicit solution of (31) after Udwadia and Kalaba: v̇ = v̇ᵤ + M^-½ (A M^-½)⁺ (b - A v̇ᵤ), (nv,) in m/s² and rad/s².

    From "Analytical Dynamics: A New Approach" (1996), to which the note refers for (32). It serves for comparison: it
    gives no multipliers, and the pseudoinverse is affected by the conditioning of M as well as of A.

    Raises:
        InputRefused: if shapes do not fit or a value is not finite.
    """
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    values, vectors = np.linalg.eigh(M)
    root = (vectors / np.sqrt(values)) @ vectors.T  # M^-½
    U, s, Vt = np.linalg.svd(A @ root, full_matrices=False)
    kept = s > max(RANK_TOLERANCE * float(np.max(s, initial=0.0)), ZERO / float(np.sqrt(values[0])))
    pseudoinverse = (Vt[kept].T / s[kept]) @ U[:, kept].T
    return np.asarray(v_dot_u + root @ (pseudoinverse @ (b - A @ v_dot_u)))


def gauss_functional(M: Array, v_dot: Array, v_dot_u: Array) -> float:
    """Gauss's functional ("the constraint"), ½‖v̇ - v̇ᵤ‖²_M of (31), W·1/s, which Gauss's principle minimizes over v̇."""
    difference = v_dot - v_dot_u
    return float(0.5 * difference @ M @ difference)


def admissible_directions(A: Array) -> Array:
    """Basis of the admissible virtual displacements, A δq = 0: the tangent space of (17) and (19), without units.

    A constraint force does no work along any of them: f_cᵀ δq = λᵀA δq = 0 (d'Alembert; S3).

    Returns:
        N, (nv, nv - rank), with orthonormal columns and A N = 0.

    Raises:
        InputRefused: if a value is not finite.
    """
    array = np.asarray(A, dtype=np.float64)
    return _decompose(as_array("A", array, array.shape)).N


def gauss_unilateral(M: Array, v_dot_u: Array, A: Array, b: Array, C: Array, d: Array) -> ConstrainedMotion:
    """Solve Gauss's problem (31) with unilateral constraints: A v̇ = b and C v̇ ≥ d, in m/s² and rad/s².

    The functional is that of `gauss`. The conditions are those of (32) with Aᵀλ + Cᵀμ in place of Aᵀλ, and μ ≥ 0,
    C v̇ ≥ d, μᵀ(C v̇ - d) = 0: a contact pushes or lifts off, never both. After Moreau, "Quadratic programming in
    mechanics: dynamics of one-sided constraints" (1966); solved as a least-distance problem by non-negative least
    squares (Lawson, Hanson, "Solving Least Squares Problems", 1974, chapter 23), which ends after finitely many steps.
    The acceleration is unique; with redundant rows of C, μ is one of several with the same generalized force.

    Args:
        C: unilateral constraints, (m, nv): for a contact, the rows of its normal motion.
        d: right-hand side of the unilateral constraints, (m,).

    Raises:
        InputRefused: if shapes do not fit, a value is not finite, or M is not positive definite.
        NoSolution: if the constraints contradict each other.
    """
    base = gauss(M, v_dot_u, A, b)
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    rows = np.asarray(d, dtype=np.float64).size
    C, d = as_array("C", C, (rows, len(v_dot_u))), as_array("d", d, (rows,))
    N = admissible_directions(A)
    # With v̇ = base + W z the functional is ½‖z‖² plus a constant.
    W = scipy.linalg.solve_triangular(np.linalg.cholesky(N.T @ M @ N), N.T, lower=True).T
    G, h = C @ W, d - C @ base.v_dot
    sizes = np.maximum(np.linalg.norm(G, axis=1), 1.0e-12)
    G, h = G / sizes[:, None], h / sizes
    mu = _least_distance(G, h, (C, d))
    v_dot = base.v_dot + W @ (G.T @ mu)
    push = mu / sizes
    split = _decompose(A)
    multipliers, constraint_force = _multipliers(split, M @ (v_dot - v_dot_u) - C.T @ push)
    return ConstrainedMotion(
        v_dot=v_dot,
        multipliers=multipliers,
        constraint_force=constraint_force,
        push=push,
        push_force=C.T @ push,
        rank=base.rank,
        condition=base.condition,
    )


def _least_distance(G: Array, h: Array, evidence: tuple[Array, Array]) -> Array:
    """Multipliers μ ≥ 0 of min ½‖z‖² subject to G z ≥ h, so that z = Gᵀμ; (m,)."""
    scale = float(np.max(h, initial=0.0))
    if not scale > 0.0:
        return np.zeros(len(h))
    E = np.vstack([G.T, h / scale])
    target = np.zeros(len(E))
    target[-1] = 1.0
    u, _ = scipy.optimize.nnls(E, target)
    left = 1.0 - float(E[-1] @ u)
    if not left > 1.0e-12:
        raise NoSolution("the one-sided constraints C v̇ ≥ d contradict each other", "inconsistent", evidence)
    mu = np.asarray(u * scale / left)
    # The division loses digits if the distance is large: solve once more on the active set that was found.
    active = mu > 0.0
    exact = np.linalg.lstsq(G[active] @ G[active].T, h[active], rcond=None)[0]
    if (exact >= 0.0).all():
        mu[active] = exact
    return mu
