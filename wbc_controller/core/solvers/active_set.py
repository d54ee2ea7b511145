"""The active set of the problem before, and the answer that it leads to: one linear solve."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv

from wbc_controller.core.problem import QuadraticProgram, Squares
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

    Mostly H = RᵀR + diag(d) with few rows R (`Squares`), and d > 0 but for the k first columns, those of the base. With
    z the columns after them, B = [A; R; W] and p = -[y; R x; λ], the rows of z say x_z = d⁻¹ (B_zᵀp - g_z), and what is
    left is a smaller system, where E is 1 on the diagonal of the rows R and 0 elsewhere:

        | B_z d⁻¹ B_zᵀ + E   B_k |  | p   |   | [b; 0; w] + B_z d⁻¹ g_z |
        | B_kᵀ               0   |  | x_k | = | g_k                     |

    Where weights are so far apart (1e6 and more) that it loses too many digits, it is left alone until they change.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        """Start with no inequality active."""
        self._n, self._m = n, equalities
        self._side = np.zeros(n + inequalities, dtype=np.int8)  # 1 at the upper bound, -1 at the lower one
        self._active = self._side.nonzero()[0]
        self._none = np.zeros(len(self._side))
        self._none.setflags(write=False)
        self._too_far: Array | None = None  # the d⁻¹ with which the smaller system was not accurate enough
        self._memory = np.zeros((2 * n + equalities) ** 2)

    def learn(self, multipliers: Array) -> None:
        """Take the active set of an answer, (n + m_in,) as in `Answer`."""
        self._side = (multipliers > 0.0).astype(np.int8) - (multipliers < 0.0)
        self._active = self._side.nonzero()[0]

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Try it; None where it is not the one of this problem."""
        active = self._active
        if self._m + len(active) > self._n:
            return None
        W, w = self._rows(problem, active) if len(active) else (None, None)
        squares = problem.cost.squares
        condensed = (
            squares is not None and squares.inverse is not self._too_far and len(squares.rows) + squares.first < self._n
        )
        found = self._condensed(problem, squares, W, w) if squares and condensed else self._full(problem, W, w)
        if found is None:
            return None
        x, costs, objective = found
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
            if (self._side[active] * costs < 0.0).any():
                return None
            multipliers = np.zeros(len(self._side))
            multipliers[active] = costs
        return Answer(x, "optimal", 1, multipliers, residuals, objective)

    def _rows(self, problem: QuadraticProgram, active: np.ndarray) -> tuple[Array, Array]:
        """W, (k, n), and w, (k,)."""
        bounds = active[active < self._n]
        W = np.zeros((len(active), self._n))
        W[np.arange(len(bounds)), bounds] = 1.0
        W[len(bounds) :] = problem.C[active[len(bounds) :] - self._n]
        return W, problem.bounds[(self._side[active] > 0).astype(np.intp), active]

    def _full(self, problem: QuadraticProgram, W: Array | None, w: Array | None) -> tuple[Array, Array, float] | None:
        """x, λ and the objective; None where they are not determined."""
        n, m = self._n, self._n + self._m
        size = m if W is None else m + len(W)
        K = self._memory[: size * size].reshape(size, size)
        right = np.empty(size)
        K[:n, :n] = problem.H
        K[n:m, :n] = problem.A
        np.negative(problem.g, out=right[:n])
        right[n:m] = problem.b
        if W is not None:
            K[m:, :n], right[m:] = W, w
        K[:n, n:] = K[n:, :n].T
        K[n:, n:] = 0.0
        answer = _solution(K, right)
        if answer is None:
            return None
        # As below: right is [-g; b; w].
        return answer[:n], answer[m:], -0.5 * float(right @ answer)

    def _condensed(
        self, problem: QuadraticProgram, squares: Squares, W: Array | None, w: Array | None
    ) -> tuple[Array, Array, float] | None:
        """The same by the smaller system."""
        B, g, first, m = squares.stack, problem.cost.g, squares.first, self._m
        rows = len(B)
        if W is not None:
            B = np.vstack((B, W))
        k = len(B)
        size = k + first
        T = B * squares.inverse  # B_z d⁻¹, and 0 in the columns of the base
        K = self._memory[: size * size].reshape(size, size)
        K[:k, :k] = T.dot(B.T)
        self._memory[m * (size + 1) : rows * (size + 1) : size + 1] += 1.0
        K[:k, k:] = B[:, :first]
        K[k:, :k] = K[:k, k:].T
        K[k:, k:] = 0.0
        right = np.empty(size)
        T.dot(g, out=right[:k])
        right[:m] += problem.b
        if w is not None:
            right[rows:k] += w
        right[k:] = g[:first]
        answer = _solution(K, right)
        if answer is None:
            return None
        p = answer[:k]
        x = p.dot(T)
        x -= squares.inverse * g
        x[:first] = answer[k:]
        costs = -p[rows:]
        # xᵀHx is -gᵀx - bᵀy - wᵀλ: multiply the conditions of the minimum by xᵀ.
        bounds = 0.0 if w is None else float(w @ costs)
        return x, costs, 0.5 * (float(g.dot(x)) + float(problem.b.dot(p[:m])) - bounds)


def _solution(K: Array, right: Array) -> Array | None:
    """Of K x = right, K symmetric and overwritten; None where K is next to singular or a value is not finite."""
    if not len(right):  # such as a fixed base, and tasks on joints alone
        return right
    _, _, answer, info = dgesv(K.T, right, overwrite_a=True)  # of the symmetric K the transpose saves a copy
    return answer if info == 0 and answer.dot(answer) <= _LARGEST**2 else None  # None for NaN
