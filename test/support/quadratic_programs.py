"""Quadratic programs of a known structure."""

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram, Squares


def squares_problem(rng, n=24, equalities=5, inequalities=12, rows=7, first=4, outputs=3):
    """Such as the controller makes them: few rows, and a diagonal that leaves out the first columns."""
    problem = QuadraticProgram.empty(n, equalities, inequalities, rows, outputs)
    problem.offset[:] = rng.normal(size=outputs)
    problem.memory[:rows] = rng.normal(size=(rows, n + 1))
    problem.A[:], inside = rng.normal(size=(equalities, n)), rng.normal(size=n)
    problem.A[equalities - first :, :first] += 5.0 * np.eye(first)  # as that of a base is, far from singular
    problem.b[:], problem.C[:] = problem.A @ inside, rng.normal(size=(inequalities, n))
    problem.upper[:] = problem.C @ inside + rng.uniform(0.0, 0.3, inequalities)
    problem.x_lower[first::2] = inside[first::2] - 0.05
    diagonal, slack = 10.0 ** rng.uniform(-3.0, 1.0, n - first), 10.0 ** rng.uniform(-1.0, 3.0, rows)
    inverse, minus_target = np.zeros(n + 1), np.zeros(n + 1)
    inverse[first:-1], minus_target[first:-1], minus_target[-1] = 1.0 / diagonal, rng.normal(size=n - first), 1.0
    stack = problem.memory[: rows + equalities]
    problem.cost.pose(Squares(stack, slack, first, diagonal, inverse, minus_target, constant=3.0))
    return problem
