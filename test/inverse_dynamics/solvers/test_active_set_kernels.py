"""Active-set kernel against NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quadratic_programs import squares_problem, under

from wbc_controller.inverse_dynamics.formulation.problem import QuadraticCost
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet, LevelWorkspace


def unbounded_problem(**sizes):
    """Return a problem without inequality constraints, and no active bound."""
    problem = squares_problem(np.random.default_rng(3), **sizes)
    problem.bounds[:] = [[-np.inf], [np.inf]]
    return problem, np.zeros(problem.bounds.shape[1], dtype=np.int8)


def solve_condensed(problem, sides):
    """Return True for the right active set, cost, residuals and multipliers."""
    memory = LevelWorkspace(problem, problem.cost.squares.base)
    outcome, cost, _ = solve_level(problem, problem.cost.squares, sides, memory)
    return outcome == kernel.SOLVED, cost + problem.cost.squares_constant, memory.residuals, memory.multipliers


def solve_level(problem, squares, sides, memory, kept=0):
    """Return the outcome, the sum of squares, and the next active set."""
    active_set = ActiveSet(problem.n, len(problem.b), len(problem.upper))
    active_set.recall({"side": sides})
    outcome, _, cost = active_set.solve_level(problem, squares, memory, kept)
    return outcome, cost, active_set._sides[1]


def plain_level(problem, squares, sides, kept, x_above):
    """Return x, multipliers and cost of one level from the full system by least squares."""
    n, active = problem.n, sides.nonzero()[0]
    cost = QuadraticCost(np.zeros((n, n)), np.zeros(n))
    cost.update(squares, 0.0)
    E = np.vstack([problem.A, kept, problem.rows(active)])
    e = np.concatenate([problem.b, kept @ x_above, problem.bounds[(sides[active] > 0).astype(int), active]])
    K = np.block([[cost.H, E.T], [E, np.zeros((len(E), len(E)))]])
    found = np.linalg.lstsq(K, np.concatenate([-cost.g, e]), rcond=1e-13)[0]
    multipliers = np.zeros(len(sides))
    multipliers[active] = found[n + len(E) - len(active) :]
    return found[:n], multipliers, cost.value(found[:n])


def test_memory_without_room_for_the_base_is_refused():
    problem = squares_problem(np.random.default_rng(0), equalities=6, rows=9, base=6)
    memory = LevelWorkspace(problem, 6)
    memory.rows = memory.rows[:-1]
    with pytest.raises(ValueError, match="memory for the levels is too small"):
        solve_level(problem, problem.cost.squares, np.zeros(problem.bounds.shape[1], dtype=np.int8), memory)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    base=st.integers(0, 6),
    rows=st.integers(0, 9),
    equalities=st.integers(0, 4),
    bound=st.integers(0, 4),
)
def test_kernel_equals_numpy(seed, base, rows, equalities, bound):
    rng = np.random.default_rng(seed)
    problem = squares_problem(rng, equalities=base + equalities, rows=rows, base=base)
    sides = np.zeros(problem.bounds.shape[1], dtype=np.int8)
    if bound:
        sides[base + 2] = -1  # every other one from the first on has a lower bound
        sides[problem.n : problem.n + bound - 1] = 1
    nothing = np.zeros((0, problem.n))
    x, multipliers, cost = plain_level(problem, problem.cost.squares, sides, nothing, np.zeros(problem.n))
    solved, found_cost, found, found_multipliers = solve_condensed(problem, sides)
    size = max(1.0, float(np.abs(x).max()))
    right_set = (sides * multipliers >= 0.0).all() and problem.residuals(x).violation <= kernel.FEASIBLE
    assert solved == right_set
    np.testing.assert_allclose(found.value[: problem.n], x, rtol=0.0, atol=1e-10 * size)
    np.testing.assert_allclose(found.value[problem.n :], problem.C @ x, rtol=0.0, atol=1e-9 * size)
    assert found.least_room == found.room.min()
    assert found.violation == max(0.0, -found.least_room, found.equalities.max(initial=0.0))
    if right_set:
        assert found_cost == pytest.approx(cost + problem.cost.squares_constant, rel=1e-9)
        np.testing.assert_allclose(found_multipliers, multipliers, atol=1e-9 * max(1.0, np.abs(multipliers).max()))


def test_nearly_singular_system_is_refused():
    problem, sides = unbounded_problem()
    assert solve_condensed(problem, sides)[0]
    problem.A[0] = 0.0
    problem.A[0, 4] = 1.0e-9  # x₄ = 1e9, with a multiplier beyond the largest
    problem.b[0] = 1.0
    assert not solve_condensed(problem, sides)[0]


def test_refinement_with_different_weights():
    problem, sides = unbounded_problem()
    squares = problem.cost.squares
    squares.diagonal[squares.base :][:3] *= 1.0e-9
    solved, cost, refined, _ = solve_condensed(problem, sides)
    assert solved
    assert refined.violation <= kernel.PRECISE
    x = refined.value[: problem.n]
    assert cost == pytest.approx(problem.cost.value(x), rel=1e-6)
    # stationary along directions free of equality constraints
    free = np.linalg.svd(problem.A)[2][len(problem.b) :]
    gradient = problem.H @ x + problem.g
    assert np.abs(free @ gradient).max() <= 1e-9 * np.abs(gradient).max()


@settings(max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 4),
    base=st.integers(0, 4),
    bound=st.integers(0, 2),
    dependent=st.booleans(),
)
def test_levels_equal_numpy(seed, count, base, bound, dependent):
    rng = np.random.default_rng(seed)
    problem = squares_problem(rng, equalities=base + 2, rows=3, base=base)
    n, sides = problem.n, np.zeros(problem.bounds.shape[1], dtype=np.int8)
    costs = [problem.cost.squares]
    costs += [under(problem, squares_problem(rng, n=n, rows=2 + i, base=base).cost.squares) for i in range(count - 1)]
    if dependent:  # on an equality constraint, and on a row of the level above
        costs[0].rows[2, :-1] = 2.0 * problem.A[0]
        costs[1].rows[0, :-1] = costs[0].rows[1, :-1]
    problem.bounds[:] = [[-np.inf], [np.inf]]
    free, _, _ = plain_level(problem, costs[0], sides, np.zeros((0, n)), np.zeros(n))
    problem.upper[:bound] = (problem.C @ free)[:bound] - 0.1
    expected = np.zeros(len(sides))
    memory = LevelWorkspace(problem, base, sum(len(squares.weights) for squares in costs))
    x, kept = free, np.zeros((0, n))
    for squares in costs:
        sides[n : n + bound] = rng.random(bound) < (0.5 if memory.above else 1.0)
        x, own, cost = plain_level(problem, squares, sides, kept, x)
        outcome, found_cost, other = solve_level(problem, squares, sides, memory, len(squares.weights))
        if (own < 0.0).any() or problem.residuals(x).violation > kernel.FEASIBLE:
            assert outcome == kernel.WRONG_SET
            violated = np.concatenate([x, problem.C @ x]) > problem.bounds[1] + kernel.FEASIBLE
            np.testing.assert_array_equal(other, violated | (own > 0.0))
            return
        assert outcome == kernel.SOLVED
        expected = np.where(expected == 0.0, own, expected)
        assert memory.residuals.least_room == memory.residuals.room.min()
        tolerance = 1e-8 * max(1.0, float(np.abs(x).max()))
        np.testing.assert_allclose(memory.residuals.value[:n], x, rtol=0.0, atol=tolerance)
        np.testing.assert_allclose(memory.multipliers, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
        assert found_cost == pytest.approx(cost, rel=1e-6)
        kept = np.vstack([kept, squares.rows[: len(squares.weights), :-1]])


def test_levels_below_determined_or_kept_rows():
    problem, sides = unbounded_problem(rows=30)
    squares = problem.cost.squares
    left = problem.n - len(problem.b)
    for kept, expected in ((left - 1, kernel.SOLVED), (left, kernel.NOTHING_FREE), (left + 5, kernel.NOTHING_FREE)):
        memory = LevelWorkspace(problem, squares.base, kept)
        assert solve_level(problem, squares, sides, memory, kept)[0] == kernel.SOLVED
        assert solve_level(problem, squares, sides, memory)[0] == expected
    problem, sides = unbounded_problem()
    squares = problem.cost.squares
    squares.rows[1] = squares.rows[0]
    memory = LevelWorkspace(problem, squares.base, 2)
    assert solve_level(problem, squares, sides, memory, 2)[0] == kernel.SOLVED
    assert solve_level(problem, squares, sides, memory)[0] == kernel.SOLVED
    memory.rows[-1, -1] += 1.0e-6  # the same row with two values
    assert solve_level(problem, squares, sides, memory)[0] == kernel.NOT_FOUND


@pytest.mark.parametrize("place", ["rows", "target", "weights", "diagonal"])
def test_nan_is_never_a_solution(place):
    problem, sides = unbounded_problem()
    getattr(problem.cost.squares, place).reshape(-1)[-3] = math.nan
    assert not solve_condensed(problem, sides)[0]


def test_residuals():
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
        kept, spoilt.flat[1] = spoilt.flat[1], math.nan
        assert math.isnan(problem.residuals(x).violation)
        spoilt.flat[1] = kept
