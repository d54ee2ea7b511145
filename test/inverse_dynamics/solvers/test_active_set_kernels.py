"""Held against the same equations in NumPy, which also say what they are."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quadratic_programs import squares_problem

from wbc_controller.inverse_dynamics.formulation.problem import Quadratic, Residuals
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.inverse_dynamics.solvers.active_set import bind, work_memory

FEASIBLE, PRECISE, LARGEST = 1.0e-8, 1.0e-11, 1.0e8


def condensed(problem, sides, largest=LARGEST, precise=PRECISE):
    """What the kernel returns, and what it fills."""
    squares, found = problem.cost.squares, memory(problem)
    work = work_memory(problem, squares, 0)
    outcome, *returned = one_level(problem, squares, sides, work, 0, 0, found, largest, precise)
    residuals = Residuals(found, len(sides), len(problem.b), *returned[1:])
    return (outcome == kernel.SOLVED, *returned), residuals, residuals.multipliers


def memory(problem):
    """For what the kernel finds."""
    return np.full(4 * problem.bounds.shape[1] + len(problem.b) + len(problem.offset), np.nan)


def one_level(problem, squares, sides, work, count, kept, found, largest=LARGEST, precise=PRECISE, other=None):
    both = np.stack([sides, np.zeros(len(sides), dtype=np.int8)])
    bound = bind(squares, problem, both, (FEASIBLE, precise, largest))
    returned = kernel.condensed(bound.table, squares.constant, work, count, kept, found)
    if other is not None:
        other[:] = both[1]
    return returned


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
    (solved, found_cost, least, violation), found, found_multipliers = condensed(problem, sides)
    size = max(1.0, float(np.abs(x).max()))
    right_set = (sides * multipliers >= 0.0).all() and problem.violation(x) <= FEASIBLE
    assert solved == right_set
    np.testing.assert_allclose(found.value[: problem.n], x, rtol=0.0, atol=1e-10 * size)
    np.testing.assert_allclose(found.value[problem.n :], problem.C @ x, rtol=0.0, atol=1e-9 * size)
    assert least == found.room.min()
    assert violation == max(0.0, -least, found.equalities.max(initial=0.0))
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


def plain_level(problem, squares, sides, kept, x_above):
    """x, the multipliers and the cost of one level, from the whole system in the least-squares sense."""
    cost, active, n = Quadratic(np.zeros((problem.n, problem.n)), np.zeros(problem.n)), sides.nonzero()[0], problem.n
    cost.pose(squares)
    E = np.vstack([problem.A, kept, problem.rows(active)])
    e = np.concatenate([problem.b, kept @ x_above, problem.bounds[(sides[active] > 0).astype(int), active]])
    K = np.block([[cost.H, E.T], [E, np.zeros((len(E), len(E)))]])
    found = np.linalg.lstsq(K, np.concatenate([-cost.g, e]), rcond=1e-13)[0]
    multipliers = np.zeros(len(sides))
    multipliers[active] = found[n + len(E) - len(active) :]
    return found[:n], multipliers, cost.value(found[:n])


@settings(deadline=None, max_examples=200)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 4),
    first=st.integers(0, 4),
    bound=st.integers(0, 2),
    dependent=st.booleans(),
)
def test_every_level_is_what_numpy_makes_of_it_below_those_above(seed, count, first, bound, dependent):
    rng = np.random.default_rng(seed)
    problem = squares_problem(rng, equalities=first + 2, rows=3, first=first)
    n, sides = problem.n, np.zeros(problem.bounds.shape[1], dtype=np.int8)
    costs = [problem.cost.squares]
    costs += [squares_problem(rng, n=n, rows=2 + i, first=first).cost.squares for i in range(count - 1)]
    if dependent:  # on an equality constraint, and on a row of the level above
        costs[0].stack[2, :-1] = 2.0 * problem.A[0]
        costs[1].stack[0, :-1] = costs[0].stack[1, :-1]
    problem.bounds[:] = [[-np.inf], [np.inf]]
    free, _, _ = plain_level(problem, costs[0], sides, np.zeros((0, n)), np.zeros(n))
    problem.upper[:bound] = (problem.C @ free)[:bound] - 0.1
    found, expected = memory(problem), np.zeros(len(sides))
    work, rows = work_memory(problem, costs[0], sum(len(squares.slack) for squares in costs)), 0
    x, kept = free, np.zeros((0, n))
    for squares in costs:
        sides[n : n + bound] = rng.random(bound) < (0.5 if rows else 1.0)
        x, own, cost = plain_level(problem, squares, sides, kept, x)
        other = np.zeros(len(sides), dtype=np.int8)
        outcome, found_cost, least, _ = one_level(
            problem, squares, sides, work, rows, len(squares.slack), found, other=other
        )
        if (own < 0.0).any() or problem.violation(x) > FEASIBLE:
            assert outcome == kernel.WRONG_SET
            violated = np.concatenate([x, problem.C @ x]) > problem.bounds[1] + FEASIBLE
            np.testing.assert_array_equal(other, violated | (own > 0.0))
            return
        assert outcome == kernel.SOLVED
        expected = np.where(expected == 0.0, own, expected)
        multipliers = found[len(sides) : 2 * len(sides)]
        assert least == found[2 * len(sides) : 4 * len(sides)].min()
        np.testing.assert_allclose(found[:n], x, rtol=0.0, atol=1e-8 * max(1.0, float(np.abs(x).max())))
        np.testing.assert_allclose(multipliers, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
        assert found_cost == pytest.approx(cost, rel=1e-6)
        kept = np.vstack([kept, squares.stack[: len(squares.slack), :-1]])
        rows = (rows or len(problem.b) - first) + len(squares.slack)


def test_below_rows_that_decide_everything_nothing_is_free():
    rng = np.random.default_rng(3)
    problem = squares_problem(rng, rows=30)
    problem.bounds[:] = [[-np.inf], [np.inf]]
    squares, sides = problem.cost.squares, np.zeros(problem.bounds.shape[1], dtype=np.int8)
    own, found = len(problem.b) - squares.first, memory(problem)
    left = problem.n - len(problem.b)
    for kept, expected in ((left - 1, kernel.SOLVED), (left, kernel.NOTHING_FREE), (left + 5, kernel.NOTHING_FREE)):
        work = work_memory(problem, squares, kept)
        assert one_level(problem, squares, sides, work, 0, kept, found)[0] == kernel.SOLVED
        assert one_level(problem, squares, sides, work, own + kept, 0, found)[0] == expected


def test_a_level_that_loses_what_one_above_keeps_is_no_solution():
    problem = squares_problem(np.random.default_rng(3))
    problem.bounds[:] = [[-np.inf], [np.inf]]
    squares, sides = problem.cost.squares, np.zeros(problem.bounds.shape[1], dtype=np.int8)
    squares.stack[1] = squares.stack[0]
    work, found = work_memory(problem, squares, 2), memory(problem)
    rows = len(problem.b) - squares.first + 2
    assert one_level(problem, squares, sides, work, 0, 2, found)[0] == kernel.SOLVED
    assert one_level(problem, squares, sides, work, rows, 0, found)[0] == kernel.SOLVED
    work[-1] += 1.0e-6  # the same row at two values
    assert one_level(problem, squares, sides, work, rows, 0, found)[0] == kernel.NOT_FOUND


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
    np.testing.assert_allclose(found.outputs, problem.C[:3] @ x + problem.offset, atol=1e-13)
    np.testing.assert_allclose(found.room, [value - problem.bounds[0], problem.bounds[1] - value], atol=1e-13)
    assert found.least_room == found.room.min()
    assert found.violation == max(0.0, -found.room.min(), found.equalities.max())
    for spoilt in (problem.b, problem.C, problem.bounds):
        kept = spoilt.reshape(-1)[1]
        spoilt[(1,) if spoilt.ndim == 1 else (0, 1)] = math.nan
        assert math.isnan(problem.violation(x))
        spoilt[(1,) if spoilt.ndim == 1 else (0, 1)] = kept
