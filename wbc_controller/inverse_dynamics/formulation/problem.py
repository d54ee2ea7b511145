"""A quadratic program as data."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.arrays import sum_of_squares
from wbc_controller.inverse_dynamics.formulation.problem_kernels import Constraints, LeastSquares, residuals
from wbc_controller.records import Array, LevelReport

FORCE_UNIT = 100.0  # N and N·m, for similar magnitudes of all variables; first-order solvers need it
NOT_FINITE = "not finite"  # also for NaN


class QuadraticCost:
    """Cost ½ xᵀHx + gᵀx + constant, given directly or as a sum of squares.

    H and g of a sum of squares are computed on first access:

        H = Rᵀ w R + diag(d),    g = -Rᵀ w r - d t,    constant + ½ rᵀ w r + ½ tᵀ d t
    """

    __slots__ = ("_H", "_constant", "_g", "computed", "squares", "squares_constant")

    def __init__(self, H: Array, g: Array, constant: float = 0.0) -> None:
        self._H, self._g, self._constant = H, g, constant
        self.computed = True  # H and g belong to the squares
        self.squares: LeastSquares | None = None
        self.squares_constant = 0.0  # added to the squares

    def update(self, squares: LeastSquares, constant: float) -> None:
        """Set the cost to a sum of squares plus a constant."""
        self.squares, self.squares_constant = squares, constant
        self.computed = False

    def _compute(self) -> None:
        squares = self.squares
        if self.computed or squares is None:
            return
        count, d, t = len(squares.weights), squares.diagonal, squares.target
        R, r = squares.rows[:count, :-1], squares.rows[:count, -1]
        weighted = R.T * squares.weights
        np.matmul(weighted, R, out=self._H)
        self._H.reshape(-1)[:: len(d) + 1] += d
        self._g[:] = -weighted.dot(r) - d * t
        self._constant = self.squares_constant + 0.5 * float((r * squares.weights).dot(r) + (d * t).dot(t))
        self.computed = True

    @property
    def H(self) -> Array:
        """Hessian (n, n), symmetric positive definite."""
        self._compute()
        return self._H

    @property
    def g(self) -> Array:
        """Gradient at 0, (n,)."""
        self._compute()
        return self._g

    @property
    def constant(self) -> float:
        """Constant term."""
        self._compute()
        return self._constant

    def value(self, x: Array) -> float:
        """Return the cost of x, (n,)."""
        return float(0.5 * x @ self.H @ x + self.g @ x) + self.constant


class QuadraticProgram:
    """Minimize ½ xᵀHx + gᵀx subject to A x = b, lower ≤ C x ≤ upper, x_lower ≤ x ≤ x_upper.

    The arrays are refilled in every cycle.
    """

    def __init__(self, cost: QuadraticCost, bounds: Array, memory: Array, room: int, offset: Array) -> None:
        self.cost = cost
        self.bounds = bounds  # of [x; C x], (2, n + m_in)
        self.memory = memory  # cost rows, [A, b] and C in one block, (room + m_eq + m_in, n + 1)
        self.room = room  # cost rows above the equality constraints, for one kernel
        self.offset = offset  # r of the outputs C x + r for the first rows of C, (k,)
        self.n = n = int(memory.shape[1]) - 1
        self.x_lower, self.x_upper = bounds[:, :n]  # views, (n,)
        self.lower, self.upper = bounds[:, n:]  # views, (m_in,)
        rows = memory[room:]
        equalities = len(rows) - len(self.lower)
        self.A, self.b = rows[:equalities, :n], rows[:equalities, n]  # views, (m_eq, n) and (m_eq,)
        self.C = rows[equalities:, :n]  # view, (m_in, n)
        self.constraints = Constraints(rows=rows, bounds=bounds, offset=offset)  # for kernels

    @classmethod
    def empty(cls, n: int, equalities: int, inequalities: int, room: int = 0, outputs: int = 0) -> "QuadraticProgram":
        """Allocate a problem with infinite bounds."""
        cost, bounds = QuadraticCost(np.zeros((n, n)), np.zeros(n)), np.array([[-np.inf], [np.inf]])
        memory = np.zeros((room + equalities + inequalities, n + 1))
        return cls(cost, np.repeat(bounds, n + inequalities, axis=1), memory, room, np.zeros(outputs))

    def copy(self) -> "QuadraticProgram":
        """Return a persistent copy."""
        cost = QuadraticCost(self.H.copy(), self.g.copy(), self.cost.constant)
        return QuadraticProgram(cost, self.bounds.copy(), self.memory[self.room :].copy(), 0, self.offset.copy())

    @property
    def H(self) -> Array:
        """Hessian, (n, n)."""
        return self.cost.H

    @property
    def g(self) -> Array:
        """Gradient, (n,)."""
        return self.cost.g

    @property
    def is_finite(self) -> bool:
        """True if all entries are finite and no bound is NaN."""
        squares = sum(sum_of_squares(part) for part in (self.H, self.g, self.memory[self.room :]))
        return math.isfinite(squares) and not np.isnan(self.bounds).any()

    def residuals(self, x: Array) -> "Residuals":
        """Return the residuals of the constraints at x."""
        found = Residuals(self)
        found.value[: self.n] = x
        found.least_room, found.largest_equality = residuals(self.constraints, found.memory)
        return found

    def rows(self, places: np.ndarray) -> Array:
        """Return rows of [I; C], (k, n)."""
        rows, own = np.zeros((len(places), self.n)), places < self.n
        rows[own, places[own]] = 1.0
        rows[~own] = self.C[places[~own] - self.n]
        return rows


class Residuals:
    """Residuals of the constraints at a point x."""

    __slots__ = ("_sizes", "largest_equality", "least_room", "memory", "outputs", "value")

    def __init__(self, problem: QuadraticProgram) -> None:
        total, m = self._sizes = problem.bounds.shape[1], len(problem.b)
        #: Value, room, equalities and outputs one after the other, for kernels.
        self.memory = np.empty(3 * total + m + len(problem.offset))
        self.value = self.memory[:total]  # [x; C x], (n + m_in,)
        self.outputs = self.memory[3 * total + m :]  # C x + r of the first rows, (k,)
        self.least_room = self.largest_equality = math.nan

    @property
    def room(self) -> Array:
        """Distances from lower and upper bounds, (2, n + m_in)."""
        return self.memory[self._sizes[0] : 3 * self._sizes[0]].reshape(2, -1)

    @property
    def equalities(self) -> Array:
        """|A x - b|, (m_eq,)."""
        total, m = self._sizes
        return self.memory[3 * total : 3 * total + m]

    @property
    def violation(self) -> float:
        """Largest violation of a constraint, at least 0, or NaN."""
        return max(-self.least_room, self.largest_equality, 0.0)  # the least room is NaN if any residual is


@dataclass(frozen=True, slots=True)
class SoftConstraints:
    """Soft constraints lower ≤ y + s ≤ upper on entries y of [x; C x], cost ½ Σ wᵢ sᵢ²."""

    places: np.ndarray  # in [x; C x], (k,)
    bounds: Array  # (2, k)
    weights: Array  # w, (k,)

    @classmethod
    def joined(cls, parts: Sequence["SoftConstraints"]) -> "SoftConstraints":
        """Return the union."""
        return cls(
            np.concatenate([part.places for part in parts]),
            np.hstack([part.bounds for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )


@dataclass(slots=True)
class Level:
    """Objective of one priority level: minimize ½ xᵀHx + gᵀx + ½ ‖s‖² + constant, lower ≤ G x + s ≤ upper."""

    tasks: tuple[str, ...]  # active tasks
    cost: QuadraticCost  # with regularization
    kept: Array  # first rows of the squares, (r, n), whose values lower levels must keep
    G: Array  # weighted rows of tasks with a tolerance, (k, n)
    lower: Array  # of G x + s, (k,)
    upper: Array  # of G x + s, (k,)


@dataclass(slots=True)
class Answer:
    """Result of a solver."""

    x: Array | None  # (n,)
    status: str  # by the solver
    iterations: int  # by the solver
    # of [x; C x], (n + m_in,), positive at an upper bound; Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None  # at x
    cost: float | None = None  # at x
    levels: tuple[LevelReport, ...] = ()  # one per priority level
    relaxed: tuple[str, ...] = ()  # groups with violated bounds, and failed lower levels
