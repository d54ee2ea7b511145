"""A quadratic program as data: `formulation` fills it, `solvers` solve it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.arrays import sum_of_squares
from wbc_controller.inverse_dynamics.formulation.problem_kernels import Constraints, LeastSquares, residuals
from wbc_controller.records import Array

#: Unit of the contact forces in x, N and N·m, so that all decision variables have similar magnitudes. Without this
#: scaling the first-order solvers lose two digits, and ProxQP reports feasible problems as infeasible.
FORCE_UNIT = 100.0


class QuadraticCost:
    """A cost ½ xᵀHx + gᵀx + constant, given as such or as a sum of squares.

    Most cycles need the squares alone, so their H and g are computed on first access:

        H = Rᵀ w R + diag(d),    g = -Rᵀ w r - d t,    constant + ½ rᵀ w r + ½ tᵀ d t

    Attributes:
        squares: the sum of squares; None for a cost that is given by H and g.
        squares_constant: cost that is added to the sum of squares.
        computed: whether H and g belong to the squares.
    """

    __slots__ = ("_H", "_constant", "_g", "computed", "squares", "squares_constant")

    def __init__(self, H: Array, g: Array, constant: float = 0.0) -> None:
        self._H, self._g, self._constant = H, g, constant
        self.computed = True
        self.squares: LeastSquares | None = None
        self.squares_constant = 0.0

    def update(self, squares: LeastSquares, constant: float) -> None:
        """Make the cost a sum of squares, whose arrays have new values, plus a constant."""
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
        """(n, n), symmetric positive definite."""
        self._compute()
        return self._H

    @property
    def g(self) -> Array:
        """(n,)."""
        self._compute()
        return self._g

    @property
    def constant(self) -> float:
        """The constant term."""
        self._compute()
        return self._constant

    def value(self, x: Array) -> float:
        """Cost of x, (n,)."""
        return float(0.5 * x @ self.H @ x + self.g @ x) + self.constant


@dataclass(slots=True)
class QuadraticProgram:
    """Minimize ½ xᵀHx + gᵀx subject to A x = b, lower ≤ C x ≤ upper, x_lower ≤ x ≤ x_upper.

    The arrays are refilled in every cycle; a solver may read them, but must not keep references to them.
    """

    cost: QuadraticCost  # ½ xᵀHx + gᵀx
    bounds: Array  # lower and upper bounds of x, then of C x, (2, n + m_in); -inf and inf where there is none
    # rows of the cost, then [A, b], then C, in one block, as they are used together, (room + m_eq + m_in, n + 1)
    memory: Array
    room: int  # number of rows for the cost, directly above the equality constraints: one kernel fills both
    # r of the outputs C x + r that are wanted of the first rows of C, (k,)
    offset: Array = field(default_factory=lambda: np.zeros(0))
    n: int = field(init=False)
    A: Array = field(init=False)  # equality constraints, view of `memory`, (m_eq, n)
    b: Array = field(init=False)  # right-hand sides of the equality constraints, view of `memory`, (m_eq,)
    C: Array = field(init=False)  # inequality constraints, view of `memory`, (m_in, n)
    lower: Array = field(init=False)  # lower bounds of C x, view of `bounds`, (m_in,)
    upper: Array = field(init=False)  # upper bounds of C x, view of `bounds`, (m_in,)
    x_lower: Array = field(init=False)  # lower bounds of x, view of `bounds`, (n,)
    x_upper: Array = field(init=False)  # upper bounds of x, view of `bounds`, (n,)
    constraints: Constraints = field(init=False)  # the same arrays for kernels

    def __post_init__(self) -> None:
        n = self.n = int(self.memory.shape[1]) - 1
        self.x_lower, self.x_upper = self.bounds[:, :n]
        self.lower, self.upper = self.bounds[:, n:]
        rows = self.memory[self.room :]
        equalities = len(rows) - len(self.lower)
        self.A, self.b = rows[:equalities, :n], rows[:equalities, n]
        self.C = rows[equalities:, :n]
        self.constraints = Constraints(rows=rows, bounds=self.bounds, offset=self.offset)

    @classmethod
    def empty(cls, n: int, equalities: int, inequalities: int, room: int = 0, outputs: int = 0) -> QuadraticProgram:
        """Allocate a problem with infinite bounds, room for some rows of the cost, and some outputs."""
        return cls(
            QuadraticCost(np.zeros((n, n)), np.zeros(n)),
            np.repeat([[-np.inf], [np.inf]], n + inequalities, axis=1),
            np.zeros((room + equalities + inequalities, n + 1)),
            room,
            np.zeros(outputs),
        )

    def copy(self) -> QuadraticProgram:
        """A copy that the next cycle does not overwrite."""
        cost = QuadraticCost(self.H.copy(), self.g.copy(), self.cost.constant)
        return QuadraticProgram(cost, self.bounds.copy(), self.memory[self.room :].copy(), 0, self.offset.copy())

    @property
    def H(self) -> Array:
        """(n, n), symmetric positive definite."""
        return self.cost.H

    @property
    def g(self) -> Array:
        """(n,)."""
        return self.cost.g

    @property
    def is_finite(self) -> bool:
        """Whether all entries are finite, and no bound is NaN."""
        squares = sum(sum_of_squares(part) for part in (self.H, self.g, self.memory[self.room :]))
        return math.isfinite(squares) and not np.isnan(self.bounds).any()

    def residuals(self, x: Array) -> Residuals:
        """Compute the residuals of the constraints at x."""
        found = Residuals(self)
        found.value[: self.n] = x
        found.least_room, found.largest_equality = residuals(
            self.constraints, found.value, found.room, found.equalities, found.outputs
        )
        return found

    def rows(self, places: np.ndarray) -> Array:
        """Rows of [I; C], (k, n)."""
        rows, own = np.zeros((len(places), self.n)), places < self.n
        rows[own, places[own]] = 1.0
        rows[~own] = self.C[places[~own] - self.n]
        return rows

    def violation(self, x: Array) -> float:
        """Largest violation of a constraint at x; NaN if x contains NaN."""
        return self.residuals(x).violation


class Residuals:
    """Residuals of the constraints at a point x.

    Attributes:
        value: x, then C x, (n + m_in,).
        room: distances of x and C x from their lower and upper bounds, (2, n + m_in); negative for a violated bound.
        equalities: |A x - b|, (m_eq,).
        outputs: C x + r of the first rows, (k,).
        least_room: smallest value of `room`.
        largest_equality: largest value of `equalities`.
    """

    __slots__ = ("equalities", "largest_equality", "least_room", "outputs", "room", "value")

    def __init__(self, problem: QuadraticProgram) -> None:
        """Allocate the arrays for a problem."""
        count = problem.bounds.shape[1]
        self.value, self.room = np.empty(count), np.empty((2, count))
        self.equalities, self.outputs = np.empty(len(problem.b)), np.empty(len(problem.offset))
        self.least_room = self.largest_equality = math.nan

    @property
    def violation(self) -> float:
        """Largest violation of a constraint, 0 if all hold; NaN if x or the problem contains NaN."""
        if math.isnan(self.least_room + self.largest_equality):
            return math.nan
        return max(0.0, -self.least_room, self.largest_equality)


@dataclass(frozen=True, slots=True)
class Soft:
    """Soft constraints on some entries y of x and C x: ½ Σ wᵢ sᵢ² is added to the cost, lower ≤ y + s ≤ upper."""

    places: np.ndarray  # index of each y among x and the rows of C, (k,)
    bounds: Array  # lower and upper bounds, (2, k); -inf and inf where there is none
    weights: Array  # w, (k,)

    def with_more(self, other: Soft) -> Soft:
        """These and others."""
        return Soft(
            np.concatenate([self.places, other.places]),
            np.hstack([self.bounds, other.bounds]),
            np.concatenate([self.weights, other.weights]),
        )


@dataclass(slots=True)
class Level:
    """Objective of one priority level: minimize ½ xᵀHx + gᵀx + ½ ‖s‖² + constant, lower ≤ G x + s ≤ upper."""

    tasks: tuple[str, ...]  # names of the tasks that take part in this cycle
    cost: QuadraticCost  # ½ xᵀHx + gᵀx + constant, the regularization included, so that H is positive definite
    # rows of the tasks' least-squares problem, (r, n), whose values no lower level may change; if the cost is a sum of
    # squares, its first rows. Empty if there is no lower level
    kept: Array
    G: Array  # weighted rows of the tasks with a tolerance, (k, n)
    lower: Array  # lower bounds of G x + s, (k,)
    upper: Array  # upper bounds of G x + s, (k,)
