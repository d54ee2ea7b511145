"""Quadratic programs of a known structure."""

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.formulation.problem_kernels import LeastSquares


def squares_problem(rng, n=24, equalities=5, inequalities=12, rows=7, base=4, outputs=3):
    """Such as the controller makes them: few rows, and a diagonal that leaves out the first columns."""
    problem = QuadraticProgram.empty(n, equalities, inequalities, rows, outputs)
    problem.offset[:] = rng.normal(size=outputs)
    problem.memory[:rows] = rng.normal(size=(rows, n + 1))
    problem.A[:], inside = rng.normal(size=(equalities, n)), rng.normal(size=n)
    problem.A[equalities - base :, :base] += 5.0 * np.eye(base)  # as that of a base is, far from singular
    problem.b[:], problem.C[:] = problem.A @ inside, rng.normal(size=(inequalities, n))
    problem.upper[:] = problem.C @ inside + rng.uniform(0.0, 0.3, inequalities)
    problem.x_lower[base::2] = inside[base::2] - 0.05
    diagonal, target = np.zeros(n), np.zeros(n)
    diagonal[base:], weights = 10.0 ** rng.uniform(-3.0, 1.0, n - base), 10.0 ** -rng.uniform(-1.0, 3.0, rows)
    target[base:] = rng.normal(size=n - base)
    squares = LeastSquares(
        rows=problem.memory[:rows], weights=weights, base=base, diagonal=diagonal, target=target,
        constraints=problem.constraints,
    )  # fmt: skip
    problem.cost.update(squares, 3.0)
    return problem


def under(problem, squares):
    """Return a sum of squares under the constraints of another problem."""
    return LeastSquares(**vars(squares) | {"constraints": problem.constraints})
