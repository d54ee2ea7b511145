"""Non-negative least squares against an exact solver."""

import numpy as np
import pytest

from wbc_controller.inverse_dynamics.contacts.support import friction_pyramid
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.inverse_dynamics.solvers.least_distance import solve_by_least_distance


def random_problem(rng, n=8, m=20):
    problem = QuadraticProgram.empty(n, 0, m)
    root = rng.normal(size=(n, n))
    problem.H[:], problem.g[:] = root @ root.T + 1e-3 * np.eye(n), 5.0 * rng.normal(size=n)
    problem.C[:], problem.C[3] = rng.normal(size=(m, n)), 0.0
    problem.lower[::2], problem.upper[::3] = -rng.uniform(0.0, 1.0, m)[::2], rng.uniform(0.0, 1.0, m)[::3]
    return problem


@pytest.mark.parametrize("seed", range(8))
def test_solution_and_multipliers_equal_quadprog(seed):
    problem = random_problem(np.random.default_rng(seed))
    expected, found = make_solver("quadprog", problem).solve(problem), solve_by_least_distance(problem)
    np.testing.assert_allclose(found.x, expected.x, atol=1e-7)
    stationary = problem.H @ found.x + problem.g + problem.C.T @ found.multipliers[problem.n :]
    np.testing.assert_allclose(stationary, 0.0, atol=1e-7)
    np.testing.assert_allclose(found.multipliers, expected.multipliers, atol=1e-6)
    assert np.abs(found.multipliers).max() > 0.1


def test_apex_of_friction_pyramids_and_contradictory_constraints():
    problem = QuadraticProgram.empty(9, 0, 24)
    problem.H[:], problem.g[:] = np.eye(9), np.tile([1.0, 2.0, 0.1], 3)
    for foot in range(3):
        problem.C[8 * foot : 8 * foot + 8, 3 * foot : 3 * foot + 3] = friction_pyramid(0.6)
    problem.upper[:] = 1.0e-7
    found = solve_by_least_distance(problem)
    assert problem.residuals(found.x).violation < 1e-8
    assert problem.cost.value(found.x) <= problem.cost.value(make_solver("quadprog", problem).solve(problem).x) + 1e-9
    problem = QuadraticProgram.empty(2, 0, 2)
    problem.H[:], problem.C[:, 0] = np.eye(2), 1.0
    problem.lower[0], problem.upper[1] = 1.0, 0.0
    assert solve_by_least_distance(problem).x is None
