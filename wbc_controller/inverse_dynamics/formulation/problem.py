"""A quadratic program as data: `formulation` fills it, `solvers` solve it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.arrays import sum_of_squares
from wbc_controller.inverse_dynamics.formulation.residual_kernels import residuals
from wbc_controller.records import Array


@dataclass(slots=True)
class Squares:
    """A cost as a sum of squares, ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dᵢ (xᵢ - tᵢ)² + constant.

    So H = Rᵀ w R + diag(d), and g = -Rᵀ w r - d t.

    Attributes:
        stack: [R, r], and below it, for the first level, the equality constraints [A, b], (k + m_eq, n + 1).
        slack: 1 / w, (k,).
        first: number of leading columns without d and t (those of a floating base). As many of the last equality
            constraints determine these variables: that block is invertible.
        diagonal: d of the other columns, (n - first,), positive.
        inverse: 1 / d, and 0 in the leading columns and that of the right-hand sides, (n + 1,).
        minus_target: -t, 0 in the leading columns, and 1 in that of the right-hand sides, (n + 1,).
        constant: the cost that remains when all squares are zero.
    """

    stack: Array
    slack: Array
    first: int
    diagonal: Array
    inverse: Array
    minus_target: Array
    constant: float = 0.0


class Quadratic:
    """A cost ½ xᵀHx + gᵀx + constant, whose H and g are computed on first access.

    For most cycles the squares are enough, and H and g are never needed.

    Attributes:
        squares: the squares that define the cost; None where H and g define it directly.
        formed: whether H and g have been computed.
    """

    __slots__ = ("_H", "_constant", "_g", "formed", "squares")

    def __init__(self, H: Array, g: Array, constant: float = 0.0) -> None:
        self._H = H
        self._g = g
        self._constant = constant
        self.squares: Squares | None = None
        self.formed = True

    def pose(self, squares: Squares) -> None:
        """Replace the cost by a sum of squares."""
        self.squares = squares
        self.formed = False

    def _form(self) -> None:
        squares = self.squares
        if self.formed or squares is None:
            return
        first, target = squares.first, -squares.minus_target[squares.first : -1]
        rows = squares.stack[: len(squares.slack)]
        R, r = rows[:, :-1], rows[:, -1]
        weighted = R.T / squares.slack
        np.matmul(weighted, R, out=self._H)
        self._H.reshape(-1)[first * (len(self._g) + 1) :: len(self._g) + 1] += squares.diagonal
        np.negative(weighted.dot(r), out=self._g)
        self._g[first:] -= squares.diagonal * target
        squared = float((r / squares.slack).dot(r) + (squares.diagonal * target).dot(target))
        self._constant = squares.constant + 0.5 * squared
        self.formed = True

    @property
    def H(self) -> Array:
        """(n, n), symmetric positive definite."""
        self._form()
        return self._H

    @property
    def g(self) -> Array:
        """(n,)."""
        self._form()
        return self._g

    @property
    def constant(self) -> float:
        """The constant term, with which the cost equals the sum of squares."""
        self._form()
        return self._constant

    def add(self, rows: Array, right: Array) -> None:
        """Add ½ ‖rows x - right‖², in place: rows (k, n), right (k,)."""
        self._form()
        self.squares = None
        self._H += rows.T @ rows
        self._g -= rows.T @ right
        self._constant += 0.5 * float(right @ right)

    def value(self, x: Array) -> float:
        """The cost of x, (n,)."""
        return float(0.5 * x @ self.H @ x + self.g @ x) + self.constant


@dataclass(slots=True)
class QuadraticProgram:
    """Minimize ½ xᵀHx + gᵀx subject to A x = b, lower ≤ C x ≤ upper, x_lower ≤ x ≤ x_upper.

    The arrays are refilled in every cycle; a solver may read them, but must not keep references to them.

    Attributes:
        cost: ½ xᵀHx + gᵀx.
        bounds: lower and upper bounds of x, then of C x, (2, n + m_in); -inf and inf where there is none.
        memory: rows of the cost, then [A, b], then C, in one block, as they are used together,
            (room + m_eq + m_in, n + 1).
        room: number of rows for the cost.
        offset: r of the outputs C x + r that are wanted of the first rows of C, (k,).
        n: number of decision variables.
        A: equality constraints, view of `memory`, (m_eq, n).
        b: right-hand sides of the equality constraints, view of `memory`, (m_eq,).
        C: inequality constraints, view of `memory`, (m_in, n).
        lower: lower bounds of C x, view of `bounds`, (m_in,).
        upper: upper bounds of C x, view of `bounds`, (m_in,).
        x_lower: lower bounds of x, view of `bounds`, (n,).
        x_upper: upper bounds of x, view of `bounds`, (n,).
        constraints: [A, b] and below it [C, 0], view of `memory`, (m_eq + m_in, n + 1).
    """

    cost: Quadratic
    bounds: Array
    memory: Array
    room: int
    offset: Array = field(default_factory=lambda: np.zeros(0))
    n: int = field(init=False)
    A: Array = field(init=False)
    b: Array = field(init=False)
    C: Array = field(init=False)
    lower: Array = field(init=False)
    upper: Array = field(init=False)
    x_lower: Array = field(init=False)
    x_upper: Array = field(init=False)
    constraints: Array = field(init=False)

    def __post_init__(self) -> None:
        n = self.n = int(self.memory.shape[1]) - 1
        self.x_lower, self.x_upper = self.bounds[:, :n]
        self.lower, self.upper = self.bounds[:, n:]
        rows = self.memory[self.room :]
        equalities = len(rows) - len(self.lower)
        self.A, self.b = rows[:equalities, :n], rows[:equalities, n]
        self.C = rows[equalities:, :n]
        self.constraints = rows

    @classmethod
    def empty(cls, n: int, equalities: int, inequalities: int, room: int = 0, outputs: int = 0) -> QuadraticProgram:
        """Allocate a problem with infinite bounds, room for some rows of the cost, and some outputs."""
        return cls(
            Quadratic(np.zeros((n, n)), np.zeros(n)),
            np.repeat([[-np.inf], [np.inf]], n + inequalities, axis=1),
            np.zeros((room + equalities + inequalities, n + 1)),
            room,
            np.zeros(outputs),
        )

    def copy(self) -> QuadraticProgram:
        """A copy that the next cycle does not overwrite."""
        cost = Quadratic(self.H.copy(), self.g.copy(), self.cost.constant)
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
        """Residuals of the constraints at x."""
        count, equalities = self.bounds.shape[1], len(self.b)
        found = np.zeros(4 * count + equalities + len(self.offset))
        found[: self.n] = x
        return Residuals(found, count, equalities, *residuals(self.constraints, self.bounds, self.offset, found))

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
        found: x and C x; the multipliers of their bounds, where a solver has found them; the distances of x and C x
            from their lower and upper bounds; |A x - b|; and the outputs, all one after the other,
            (4 (n + m_in) + m_eq + k,).
        least_room: the smallest value of `room`.
        violation: largest violation of a constraint, 0 where all hold; NaN if x or the problem contains NaN.
    """

    __slots__ = ("_count", "_equalities", "found", "least_room", "violation")

    def __init__(self, found: Array, count: int, equalities: int, least_room: float, violation: float) -> None:
        """Store what was found.

        Args:
            found: as above.
            count: n + m_in.
            equalities: m_eq.
            least_room: the smallest room.
            violation: the largest violation.
        """
        self.found = found
        self._count, self._equalities = count, equalities
        self.least_room, self.violation = least_room, violation

    @property
    def value(self) -> Array:
        """x, then C x, (n + m_in,)."""
        return self.found[: self._count]

    @property
    def multipliers(self) -> Array:
        """Of the bounds of x and the rows of C, (n + m_in,)."""
        return self.found[self._count : 2 * self._count]

    @property
    def room(self) -> Array:
        """Distance of x and C x from their lower and upper bounds, (2, n + m_in); negative where violated."""
        return self.found[2 * self._count : 4 * self._count].reshape(2, self._count)

    @property
    def equalities(self) -> Array:
        """|A x - b|, (m_eq,)."""
        return self.found[4 * self._count :][: self._equalities]

    @property
    def outputs(self) -> Array:
        """C x + r for its first rows, (k,)."""
        return self.found[4 * self._count + self._equalities :]


@dataclass(frozen=True, slots=True)
class Soft:
    """Soft constraints on some entries y of x and C x: ½ Σ wᵢ sᵢ² is added to the cost, lower ≤ y + s ≤ upper.

    Attributes:
        places: index of each y among x and the rows of C, (k,).
        bounds: lower and upper bounds, (2, k); -inf and inf where there is none.
        weights: w, (k,).
    """

    places: np.ndarray
    bounds: Array
    weights: Array

    def with_more(self, other: Soft) -> Soft:
        """These and others."""
        return Soft(
            np.concatenate([self.places, other.places]),
            np.hstack([self.bounds, other.bounds]),
            np.concatenate([self.weights, other.weights]),
        )


@dataclass(slots=True)
class Level:
    """Objective of one priority level: minimize ½ xᵀHx + gᵀx + ½ ‖s‖² + constant, lower ≤ G x + s ≤ upper.

    Attributes:
        tasks: names of the tasks that take part in this cycle.
        cost: ½ xᵀHx + gᵀx + constant, the regularization included, so that H is positive definite.
        kept: rows of the tasks' least-squares problem, (r, n), whose values no lower level may change; if the cost is
            squares, their first rows. Empty if there is no lower level.
        G: weighted rows of the tasks with a tolerance, (k, n).
        lower: lower bounds of G x + s, (k,).
        upper: upper bounds of G x + s, (k,).
    """

    tasks: tuple[str, ...]
    cost: Quadratic
    kept: Array
    G: Array
    lower: Array
    upper: Array

    def add(self, rows: Array, right: Array, *, kept: bool) -> None:
        """Add ½ ‖rows x - right‖² to the cost, in place: rows (k, n), right (k,).

        Args:
            rows: weighted rows.
            right: weighted right-hand sides.
            kept: whether there is a lower level, which may not change the values of the rows.
        """
        self.cost.add(rows, right)
        if kept:
            self.kept = np.vstack([self.kept, rows])
