"""Held against the same equations in NumPy, which also say what they are."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quadratic_programs import squares_problem

from wbc_controller.core.program.problem import Residuals
from wbc_controller.core.solvers import make_solver
from wbc_controller.core.solvers.active_set import work_arrays
from wbc_controller.kernels import active_set as kernel

FEASIBLE, PRECISE, LARGEST = 1.0e-8, 1.0e-11, 1.0e8


def condensed(problem, sides, largest=LARGEST, precise=PRECISE):
    """What the kernel returns, and what it fills."""
    squares, found, multipliers = problem.cost.squares, Residuals.of(problem), np.zeros(len(sides))
    returned = kernel.condensed(
        squares.stack, squares.slack, squares.first, squares.inverse, squares.minus_target, squares.constant,
        problem.constraints, problem.bounds, sides.nonzero()[0], sides, FEASIBLE, precise, largest,
        *work_arrays(problem, squares, 0), 0, 0,
        found.value, found.equalities, found.room, multipliers,
    )  # fmt: skip
    return returned, found, multipliers


def plainly_condensed(problem, sides):
    """x, the multipliers and the cost."""
    squares, n, active = problem.cost.squares, problem.n, sides.nonzero()[0]
    first, B = squares.first, squares.stack
    W = np.hstack([problem.rows(active), problem.bounds[(sides[active] > 0).astype(int), active][:, None]])
    N = np.zeros((0, n + 1))
    if first:
        N, B = np.linalg.solve(B[-first:, :first], B[-first:]), B[:-first]
    equations, B = len(B), np.vstack([B, W])
    B = B - B[:, :first] @ N
    beta = B @ squares.minus_target
    K = (B * squares.inverse) @ B.T
    K[np.arange(len(squares.slack)), np.arange(len(squares.slack))] += squares.slack
    p = np.linalg.solve(K, beta)
    x = p @ (B * squares.inverse) - squares.minus_target
    x[:first] = -N @ x
    multipliers = np.zeros(len(sides))
    multipliers[active] = -p[equations:]
    return x[:-1], multipliers, squares.constant + 0.5 * p @ beta


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    first=st.integers(0, 6),
    rows=st.integers(0, 9),
    equalities=st.integers(0, 4),
    bound=st.integers(0, 4),
)
def test_it_is_what_numpy_makes_of_the_same_equations(seed, first, rows, equalities, bound):
    rng = np.random.default_rng(seed)
    problem = squares_problem(rng, equalities=first + equalities, rows=rows, first=first)
    sides = np.zeros(problem.bounds.shape[1], dtype=np.int8)
    if bound:
        sides[first + 2] = -1  # every other one from the first on has a lower bound
        sides[problem.n : problem.n + bound - 1] = 1
    x, multipliers, cost = plainly_condensed(problem, sides)
    (solved, found_cost, least, off), found, found_multipliers = condensed(problem, sides)
    size = max(1.0, float(np.abs(x).max()))
    right_set = (sides * multipliers >= 0.0).all() and problem.violation(x) <= FEASIBLE
    assert solved == right_set
    np.testing.assert_allclose(found.value[: problem.n], x, rtol=0.0, atol=1e-10 * size)
    np.testing.assert_allclose(found.value[problem.n :], problem.C @ x, rtol=0.0, atol=1e-9 * size)
    assert least == found.room.min()
    assert off == found.equalities.max(initial=0.0)
    if right_set:
        assert found_cost == pytest.approx(cost, rel=1e-9)
        np.testing.assert_allclose(found_multipliers, multipliers, atol=1e-9 * max(1.0, np.abs(multipliers).max()))


def test_the_active_set_of_an_answer_gives_the_same_bits_every_time():
    problem = squares_problem(np.random.default_rng(3))
    sides = np.sign(make_solver("daqp", problem).solve(problem).multipliers).astype(np.int8)
    assert sides[: problem.n].any()
    assert sides[problem.n :].any()
    (solved, cost, *_), first, _ = condensed(problem, sides)
    assert solved
    for _ in range(5):
        (_, again, *_), other, _ = condensed(problem, sides)
        assert again == cost
        assert other.value.tobytes() == first.value.tobytes()


def test_an_answer_with_larger_multipliers_than_are_allowed_is_none():
    problem = squares_problem(np.random.default_rng(3))
    sides = np.sign(make_solver("daqp", problem).solve(problem).multipliers).astype(np.int8)
    assert condensed(problem, sides)[0][0]
    assert not condensed(problem, sides, largest=1.0e-6)[0][0]


def test_digits_that_weights_cost_are_refined_back():
    problem = squares_problem(np.random.default_rng(3))
    sides = np.zeros(problem.bounds.shape[1], dtype=np.int8)
    problem.bounds[0], problem.bounds[1] = -np.inf, np.inf
    squares = problem.cost.squares
    squares.diagonal[:3] *= 1.0e-9
    squares.inverse[squares.first : -1] = 1.0 / squares.diagonal
    (solved, *_, off), _, _ = condensed(problem, sides, precise=math.inf)
    assert not solved
    assert off > FEASIBLE
    (solved, cost, _, off), refined, _ = condensed(problem, sides)
    assert solved
    assert off <= PRECISE
    x = refined.value[: problem.n]
    assert cost == pytest.approx(problem.cost.value(x), rel=1e-6)
    # stationary along all that the equality constraints leave free
    free = np.linalg.svd(problem.A)[2][len(problem.b) :]
    gradient = problem.H @ x + problem.g
    assert np.abs(free @ gradient).max() <= 1e-9 * np.abs(gradient).max()


@pytest.mark.parametrize("place", ["stack", "minus_target", "slack", "inverse"])
def test_what_is_not_finite_is_never_taken_for_a_solution(place):
    problem = squares_problem(np.random.default_rng(3))
    getattr(problem.cost.squares, place).reshape(-1)[-3] = math.nan
    (solved, *_), _, _ = condensed(problem, np.zeros(problem.bounds.shape[1], dtype=np.int8))
    assert not solved


def test_residuals_are_those_of_the_definition_and_keep_a_nan():
    problem = squares_problem(np.random.default_rng(5))
    x = np.random.default_rng(6).normal(size=problem.n)
    found = problem.residuals(x)
    value = np.concatenate([x, problem.C @ x])
    np.testing.assert_allclose(found.value, value, atol=1e-13)
    np.testing.assert_allclose(found.equalities, np.abs(problem.A @ x - problem.b), atol=1e-13)
    np.testing.assert_allclose(found.room, [value - problem.bounds[0], problem.bounds[1] - value], atol=1e-13)
    assert found.least_room == found.room.min()
    assert found.violation == max(0.0, -found.room.min(), found.equalities.max())
    for spoilt in (problem.b, problem.C, problem.bounds):
        kept = spoilt.reshape(-1)[1]
        spoilt[(1,) if spoilt.ndim == 1 else (0, 1)] = math.nan
        assert math.isnan(problem.violation(x))
        spoilt[(1,) if spoilt.ndim == 1 else (0, 1)] = kept
