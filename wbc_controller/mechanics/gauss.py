"""Gauss's principle of least constraint (section 4.1, equations (30)–(32); S3, S8)."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.optimize

from wbc_controller.errors import InputRefused, NoSolution
from wbc_controller.mechanics.checks import as_array
from wbc_controller.records import Array

RANK_TOLERANCE, ZERO = 1.0e-10, 1.0e-12  # relative and absolute thresholds of zero singular values of A
CONSISTENCY_TOLERANCE = 1.0e-6  # largest part of b outside the range of A, relative to b


@dataclass(frozen=True, slots=True)
class ConstrainedMotion:
    """Solution of Gauss's problem (31)."""

    v_dot: Array  # constrained acceleration v̇*, (nv,)
    multipliers: Array  # λ of (32) with the smallest norm, (k,); for contacts the force on the robot, N or N·m
    constraint_force: Array  # f_c = Aᵀλ, (nv,) in N and N·m
    push: Array  # multipliers μ ≥ 0 of the inequalities, (m,)
    push_force: Array  # generalized force Cᵀμ, (nv,) in N and N·m
    rank: int  # rank of A
    condition: float  # largest over smallest non-zero singular value of A


def _decompose(A: Array) -> tuple[Array, Array, Array, Array]:
    """Return U, s, V, N: A = U diag(s) Vᵀ with non-zero s, and null space basis N."""
    U, s, Vt = np.linalg.svd(A)
    rank = int(np.sum(s > max(RANK_TOLERANCE * float(np.max(s, initial=0.0)), ZERO)))
    return U[:, :rank], s[:rank], Vt[:rank].T, Vt[rank:].T


def _check(M: Array, v_dot_u: Array, A: Array, b: Array) -> tuple[Array, Array, Array, Array]:
    n, k = np.size(v_dot_u), np.size(b)
    M, v_dot_u = as_array("M", M, (n, n)), as_array("v_dot_u", v_dot_u, (n,))
    return M, v_dot_u, as_array("A", A, (k, n)), as_array("b", b, (k,))


def _multipliers(U: Array, s: Array, V: Array, force: Array) -> tuple[Array, Array]:
    """Return least-norm λ with Aᵀλ = force, and Aᵀλ, computed along V for accuracy."""
    along = V.T @ force
    return U @ (along / s), V @ along


def gauss(M: Array, v_dot_u: Array, A: Array, b: Array) -> ConstrainedMotion:
    """Solve Gauss's problem (31), v̇* = argmin ½‖v̇ - v̇ᵤ‖²_M subject to A v̇ = b, (nv,) in m/s² and rad/s².

    Conditions (32): M(v̇ - v̇ᵤ) - Aᵀλ = 0 and A v̇ = b. With a basis N of the null space of A: v̇ = A⁺b + N z with
    (NᵀM N) z = NᵀM(v̇ᵤ - A⁺b); λ is the least-norm solution of Aᵀλ = M(v̇ - v̇ᵤ). v̇ and Aᵀλ are unique for redundant
    rows, too.

    Raises:
        InputRefused: if an array is invalid, or M is not positive definite.
        NoSolution: if the constraints are inconsistent; contains (A, b).
    """
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    U, s, V, N = _decompose(A)
    particular = V @ ((U.T @ b) / s)
    free = N.T @ M
    try:
        np.linalg.cholesky(free @ N)
    except np.linalg.LinAlgError as error:
        raise InputRefused(f"M is not positive definite in the null space of A: {error}") from error
    z = np.linalg.solve(free @ N, free @ (v_dot_u - particular))
    v_dot = particular + N @ z
    miss, size = np.abs(A @ v_dot - b), max(1.0, float(np.max(np.abs(b), initial=0.0)))
    if not np.max(miss, initial=0.0) <= CONSISTENCY_TOLERANCE * size:
        row = int(np.argmax(miss))
        sentence = (
            f"inconsistent constraints A v̇ = b: row {row} requires {b[row]:.6g}, best value {A[row] @ v_dot:.6g}; "
            f"redundant constraints must agree to {CONSISTENCY_TOLERANCE:.0e} of b"
        )
        raise NoSolution(sentence, "inconsistent", (A, b))
    multipliers, constraint_force = _multipliers(U, s, V, M @ (v_dot - v_dot_u))
    condition = float(s[0] / s[-1]) if len(s) else 1.0
    none, no_force = np.zeros(0), np.zeros(len(v_dot))
    return ConstrainedMotion(v_dot, multipliers, constraint_force, none, no_force, len(s), condition)


def udwadia_kalaba(M: Array, v_dot_u: Array, A: Array, b: Array) -> Array:
    """Return v̇ = v̇ᵤ + M^-½ (A M^-½)⁺ (b - A v̇ᵤ), the explicit solution of (31), (nv,) in m/s² and rad/s².

    Udwadia and Kalaba, "Analytical Dynamics: A New Approach" (1996); for comparison with `gauss`.

    Raises:
        InputRefused: if an array is invalid.
    """
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    values, vectors = np.linalg.eigh(M)
    root = (vectors / np.sqrt(values)) @ vectors.T  # M^-½
    U, s, Vt = np.linalg.svd(A @ root, full_matrices=False)
    kept = s > max(RANK_TOLERANCE * float(np.max(s, initial=0.0)), ZERO / float(np.sqrt(values[0])))
    pseudoinverse = (Vt[kept].T / s[kept]) @ U[:, kept].T
    return np.asarray(v_dot_u + root @ (pseudoinverse @ (b - A @ v_dot_u)))


def gauss_functional(M: Array, v_dot: Array, v_dot_u: Array) -> float:
    """Return Gauss's functional ½‖v̇ - v̇ᵤ‖²_M of (31), J/s²: in units of W/s."""
    difference = v_dot - v_dot_u
    return float(0.5 * difference @ M @ difference)


def admissible_directions(A: Array) -> Array:
    """Return an orthonormal basis N of the virtual displacements A δq = 0 of (17) and (19), (nv, nv - rank), no units.

    Constraint forces do no work along them: f_cᵀ δq = λᵀA δq = 0 (d'Alembert; S3).

    Raises:
        InputRefused: if a value is not finite.
    """
    return _decompose(as_array("A", A, np.shape(A)))[-1]


def gauss_unilateral(M: Array, v_dot_u: Array, A: Array, b: Array, C: Array, d: Array) -> ConstrainedMotion:
    """Solve Gauss's problem (31) with A v̇ = b and C v̇ ≥ d, in m/s² and rad/s².

    Conditions (32) with Aᵀλ + Cᵀμ, μ ≥ 0 and μᵀ(C v̇ - d) = 0 (Moreau, "Quadratic programming in mechanics: dynamics
    of one-sided constraints", 1966). Solved as a least-distance problem by non-negative least squares (Lawson, Hanson,
    "Solving Least Squares Problems", 1974, chapter 23). With redundant rows of C, μ is not unique.

    Args:
        C: unilateral constraints, (m, nv), such as normal motions of contacts.
        d: right-hand side, (m,).

    Raises:
        InputRefused: if an array is invalid, or M is not positive definite.
        NoSolution: if the constraints are inconsistent.
    """
    base = gauss(M, v_dot_u, A, b)
    M, v_dot_u, A, b = _check(M, v_dot_u, A, b)
    C, d = as_array("C", C, (np.size(d), len(v_dot_u))), as_array("d", d, (np.size(d),))
    U, s, V, N = _decompose(A)
    # v̇ = base + W z: the functional is ½‖z‖² + constant.
    W = scipy.linalg.solve_triangular(np.linalg.cholesky(N.T @ M @ N), N.T, lower=True).T
    G, h = C @ W, d - C @ base.v_dot
    sizes = np.maximum(np.linalg.norm(G, axis=1), 1.0e-12)
    G /= sizes[:, None]
    mu = _least_distance(G, h / sizes, (C, d))
    v_dot = base.v_dot + W @ (G.T @ mu)
    push = mu / sizes
    multipliers, constraint_force = _multipliers(U, s, V, M @ (v_dot - v_dot_u) - C.T @ push)
    return replace(
        base, v_dot=v_dot, multipliers=multipliers, constraint_force=constraint_force, push=push, push_force=C.T @ push
    )


def _least_distance(G: Array, h: Array, evidence: tuple[Array, Array]) -> Array:
    """Return μ ≥ 0, (m,), of min ½‖z‖² subject to G z ≥ h, with z = Gᵀμ."""
    scale = float(np.max(h, initial=0.0))
    if not scale > 0.0:
        return np.zeros(len(h))
    E = np.vstack([G.T, h / scale])
    target = np.zeros(len(E))
    target[-1] = 1.0
    u, _ = scipy.optimize.nnls(E, target)
    left = 1.0 - float(E[-1] @ u)
    if not left > 1.0e-12:
        raise NoSolution("inconsistent unilateral constraints C v̇ ≥ d", "inconsistent", evidence)
    mu = np.asarray(u * scale / left)
    # The division loses digits at large distances: solve again on the active set.
    active = mu > 0.0
    exact = np.linalg.lstsq(G[active] @ G[active].T, h[active], rcond=None)[0]
    if (exact >= 0.0).all():
        mu[active] = exact
    return mu
