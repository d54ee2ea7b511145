"""The active set of the problem before, and the answer that it leads to: one linear solve."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv, dposv

from wbc_controller.core.program.problem import QuadraticProgram, Squares
from wbc_controller.core.solvers.solver import Answer
from wbc_controller.records import Array

#: Largest violation of a constraint, as DAQP has it, in the problem's units.
_FEASIBLE = 1.0e-8
#: Largest norm of the solution of a linear system that is not next to singular: of usual ones it is 1e3.
_LARGEST = 1.0e8


class ActiveSet:
    """Solves a quadratic program where the inequalities that hold with equality are those of the one before.

    From one cycle to the next they hardly change, and often there are none. Where they are known, the answer is that of
    a linear system, with W the active ones among the rows [I; C] and w their bounds,

        | H  Aᵀ  Wᵀ | | x |   | -g |
        | A  0   0  | | y | = |  b |
        | W  0   0  | | λ |   |  w |

    which takes a fraction of the time of a solver that has to look for them. x is the minimizer exactly if it meets all
    inequalities and no multiplier λ has the wrong sign, and that is checked. Where it is not, a solver searches.

    Mostly the cost is ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dᵢ (xᵢ - tᵢ)² (`Squares`) with few rows R, and d > 0 but for the k
    first columns, those of the base, which the k last equalities determine: x_k = s - N z, with z the columns after
    them. Without them R, the other equalities and W are, as rows of z, B = [R'; A'; W'] with right sides β = [r'; b';
    w'], and with p = -[w (R'z - r'); y; λ]

        z = t + d⁻¹ Bᵀp,    (B d⁻¹ Bᵀ + E) p = β - B t

    where E is 1 / w on the diagonal of the rows R' and 0 elsewhere: half as many unknowns, and positive definite. Where
    weights are so far apart (1e11 and more) that it loses too many digits, it is left alone until they change.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        """Start with no inequality active."""
        self._n, self._m = n, equalities
        self._side = np.zeros(n + inequalities, dtype=np.int8)  # 1 at the upper bound, -1 at the lower one
        self._active = self._side.nonzero()[0]
        self._none = np.zeros(len(self._side))
        self._none.setflags(write=False)
        self._too_far: Array | None = None  # the d⁻¹ with which the smaller system was not accurate enough

    def learn(self, multipliers: Array) -> None:
        """Take the active set of an answer, (n + m_in,) as in `Answer`."""
        self._side = (multipliers > 0.0).astype(np.int8) - (multipliers < 0.0)
        self._active = self._side.nonzero()[0]

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Try it; None where it is not the one of this problem."""
        active = self._active
        if self._m + len(active) > self._n:
            return None
        rows = self._rows(problem, active) if len(active) else None
        squares = problem.cost.squares
        condensed = squares is not None and squares.inverse is not self._too_far and len(squares.stack) < self._n
        found = self._condensed(squares, rows) if squares and condensed else self._full(problem, rows)
        if found is None:
            return None
        x, minus_costs, cost = found
        residuals = problem.residuals(x)
        if not residuals.violation <= _FEASIBLE:
            if squares and condensed and not residuals.equalities.max(initial=0.0) <= _FEASIBLE:
                self._too_far = squares.inverse
                answer = self.solve(problem)
                if answer is None:  # it was not for the weights
                    self._too_far = None
                return answer
            return None
        multipliers = self._none
        if len(active):
            if (self._side[active] * minus_costs > 0.0).any():
                return None
            multipliers = np.zeros(len(self._side))
            multipliers[active] = -minus_costs
        return Answer(x, "optimal", 1, multipliers, residuals, cost)

    def _rows(self, problem: QuadraticProgram, active: np.ndarray) -> Array:
        """[W, w], (k, n + 1)."""
        bounds = active[active < self._n]
        rows = np.zeros((len(active), self._n + 1))
        rows[np.arange(len(bounds)), bounds] = 1.0
        rows[len(bounds) :, :-1] = problem.C[active[len(bounds) :] - self._n]
        rows[:, -1] = problem.bounds[(self._side[active] > 0).astype(np.intp), active]
        return rows

    def _full(self, problem: QuadraticProgram, active: Array | None) -> tuple[Array, Array, float] | None:
        """x, -λ and the cost; None where they are not determined."""
        n, m = self._n, self._n + self._m
        size = m if active is None else m + len(active)
        K, right = np.zeros((size, size)), np.empty(size)
        K[:n, :n] = problem.H
        K[n:m, :n] = problem.A
        np.negative(problem.g, out=right[:n])
        right[n:m] = problem.b
        if active is not None:
            K[m:, :n], right[m:] = active[:, :-1], active[:, -1]
        K[:n, n:] = K[n:, :n].T
        _, _, answer, info = dgesv(K.T, right, overwrite_a=True)  # of the symmetric K the transpose saves a copy
        if info != 0 or not answer.dot(answer) <= _LARGEST**2:
            return None
        # xᵀHx is -gᵀx - bᵀy - wᵀλ: multiply the conditions of the minimum by xᵀ. And right is [-g; b; w].
        return answer[:n], -answer[m:], problem.cost.constant - 0.5 * float(right @ answer)

    def _condensed(self, squares: Squares, active: Array | None) -> tuple[Array, Array, float] | None:
        """The same by the smaller system.

        The right sides are one more column, for which x has -1. The columns of the base stay, and become zero.
        """
        first = squares.first
        B = squares.stack
        if first:
            head = B[-first:]
            _, _, N, info = dgesv(head[:, :first], head)
            if info != 0:
                return None
            B = B[:-first]
        equations = len(B)
        if active is not None:
            B = np.concatenate((B, active))
        if first:
            B = B - B[:, :first].dot(N)
        T = B * squares.inverse
        beta = B.dot(squares.minus_target)  # β - B t
        p = beta
        if len(p):  # there are none for a fixed base and tasks on joints alone
            K = T.dot(B.T)
            K.reshape(-1)[: len(squares.slack) * (len(p) + 1) : len(p) + 1] += squares.slack
            _, p, info = dposv(K.T, beta, overwrite_a=True)  # of the symmetric K the transpose saves a copy
            if info != 0 or not p.dot(p) <= _LARGEST**2:
                return None
        x = p.dot(T)
        x -= squares.minus_target
        if first:
            np.negative(N.dot(x), out=x[:first])
        # (z - t)ᵀd (z - t) is pᵀB (z - t), and that B z is β - E p: what is left of all squares is half of this.
        return x[:-1], p[equations:], squares.constant + 0.5 * float(p.dot(beta))
