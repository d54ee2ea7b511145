import numpy as np
import pytest
import qpsolvers

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram, SoftConstraints
from wbc_controller.inverse_dynamics.solvers import available_solvers, make_solver
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet
from wbc_controller.inverse_dynamics.solvers.daqp import solve_carefully
from wbc_controller.inverse_dynamics.solvers.factory import require_solver
from wbc_controller.validation.fuzz.problems import feasibility_margin

pytestmark = pytest.mark.filterwarnings("ignore:.*Clarabel:UserWarning", "ignore:Converted matrix")
SOLVERS = available_solvers()
FIELDS = ("H", "g", "A", "b", "C", "bounds", "lower", "upper", "x_lower", "x_upper")


def random_problem(rng, n=20, equalities=5, inequalities=15):
    """Return a strictly convex problem around a feasible point with infinite and with binding bounds."""
    root = rng.normal(size=(n, n))
    A, C, inside = rng.normal(size=(equalities, n)), rng.normal(size=(inequalities, n)), rng.normal(size=n)
    problem = QuadraticProgram.empty(n, equalities, inequalities)
    problem.H[:] = root @ root.T + 0.1 * np.eye(n)
    problem.g[:] = 10.0 * rng.normal(size=n)
    problem.A[:], problem.b[:], problem.C[:] = A, A @ inside, C
    problem.lower[:], problem.upper[:] = C @ inside - rng.uniform(0, 2, inequalities), C @ inside + 0.5
    problem.lower[::3] = -np.inf
    problem.upper[1::3] = np.inf
    problem.x_lower[:], problem.x_upper[:] = inside - rng.uniform(0, 1, n), inside + rng.uniform(0, 1, n)
    problem.x_lower[::2] = -np.inf
    problem.x_upper[::3] = np.inf
    return problem


def drift(problem, rng, size=0.01):
    """Return the next problem: finite numbers vary slightly, equalities remain feasible."""
    moved = problem.copy()
    n = len(problem.g)
    change = size * rng.normal(size=(n, n))
    moved.H[:] += change @ change.T
    for name in ("g", "b", "lower", "upper"):
        getattr(moved, name)[:] += size * rng.uniform(0.0, 1.0, getattr(moved, name).shape)
    moved.A[:] += size * rng.normal(size=moved.A.shape)
    return moved


def reference_answer(problem, tolerance=1.0e-7):
    """Return quadprog's minimizer, checked by the optimality conditions."""
    upper, lower = np.isfinite(problem.upper), np.isfinite(problem.lower)
    G = np.vstack([problem.C[upper], -problem.C[lower]])
    h = np.concatenate([problem.upper[upper], -problem.lower[lower]])
    qp = qpsolvers.Problem(problem.H, problem.g, G, h, problem.A, problem.b, problem.x_lower, problem.x_upper)
    solution = qpsolvers.solve_problem(qp, solver="quadprog")
    assert solution.found
    assert solution.is_optimal(tolerance)
    return solution.x


@pytest.mark.parametrize("name", SOLVERS)
def test_multipliers_make_the_answer_stationary(name):
    """Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0 for some y, with signs according to the bounds."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        problem = random_problem(rng)
        solver = make_solver(name, problem)
        answer = solver.solve(problem)
        assert_agrees(solver, problem, answer, reference_answer(problem))
        n = len(problem.g)
        bounds, rows = answer.multipliers[:n], answer.multipliers[n:]
        slope = problem.H @ answer.x + problem.g + bounds + problem.C.T @ rows
        y = np.linalg.lstsq(problem.A.T, -slope, rcond=None)[0]
        scale = max(1.0, np.abs(answer.multipliers).max())
        assert np.abs(slope + problem.A.T @ y).max() < 1e-3 * scale
        value, tolerance = np.concatenate([answer.x, problem.C @ answer.x]), 1e-3 * scale
        lower, upper = np.append(problem.x_lower, problem.lower), np.append(problem.x_upper, problem.upper)
        assert (answer.multipliers[value < upper - 1e-3] <= tolerance).all()
        assert (answer.multipliers[value > lower + 1e-3] >= -tolerance).all()
        assert np.abs(answer.multipliers).max() > 0.1


def assert_agrees(solver, problem, answer, expected):
    """Check feasibility and cost within the stated tolerance."""
    assert answer.x is not None, answer.status
    tolerance = solver.tolerance
    assert problem.residuals(answer.x).violation <= tolerance
    assert np.linalg.norm(answer.x - expected, np.inf) <= 10.0 * tolerance * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("name", SOLVERS)
def test_warm_start_on_drifting_problems_that_are_not_modified(name):
    rng = np.random.default_rng(7)
    problem = random_problem(rng)
    solver = make_solver(name, problem)
    for _ in range(25):
        assert_agrees(solver, problem, solver.solve(problem), reference_answer(problem))
        problem = drift(problem, rng)
    problem = random_problem(np.random.default_rng(1))
    before = {field: np.array(getattr(problem, field)) for field in FIELDS}
    solver = make_solver(name, problem)
    first = np.array(solver.solve(problem).x)
    for field, values in before.items():
        np.testing.assert_array_equal(getattr(problem, field), values)
    answer = solver.solve(problem)
    problem.g[:] = 1.0e3  # the arrays are refilled, also in the solver's workspace
    kept = np.array(answer.x)
    solver.solve(problem)
    np.testing.assert_array_equal(answer.x, kept)
    np.testing.assert_allclose(kept, first, atol=10.0 * solver.tolerance)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("what", ["bounds", "rows", "equalities"])
def test_infeasible_problem_has_no_side_effect(name, what):
    rng = np.random.default_rng(2)
    good = random_problem(rng)
    bad = drift(good, rng)
    if what == "bounds":
        bad.C[0] = np.eye(20)[1]
        bad.lower[0], bad.upper[0], bad.x_upper[1] = 5.0, 6.0, 4.0
    elif what == "rows":
        bad.C[1] = bad.C[0]
        bad.lower[:2], bad.upper[:2] = [-3.0, 1.0], [-2.0, 2.0]
    else:
        bad.A[1] = bad.A[0]
        bad.b[:2] = [0.0, 1.0]
    solver = make_solver(name, good)
    solver.solve(good)
    for _ in range(2):  # warm, and after the failure
        answer = solver.solve(bad)
        assert answer.x is None or not bad.residuals(answer.x).violation <= 0.01
        assert answer.x is None or what != "rows"
        assert answer.status
    for problem in (good, drift(good, rng)):
        assert_agrees(solver, problem, solver.solve(problem), reference_answer(problem))


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "proxqp"])  # proxqp iterates for seconds
@pytest.mark.parametrize("field", ["H", "g", "A", "b", "C", "upper", "x_lower"])  # the controller refuses such problems
def test_nan_is_never_an_answer(name, field):
    good = random_problem(np.random.default_rng(3))
    bad = drift(good, np.random.default_rng(3))
    getattr(bad, field).flat[1] = np.nan
    assert good.is_finite
    assert not bad.is_finite
    solver = make_solver(name, good)
    solver.solve(good)
    for _ in range(2):  # warm, and after the failure
        answer = solver.solve(bad)
        assert answer.x is None or not bad.residuals(answer.x).violation <= 0.01
    assert_agrees(solver, good, solver.solve(good), reference_answer(good))


def test_unknown_solver_is_refused():
    problem = random_problem(np.random.default_rng(6))
    for call in (lambda: make_solver("dapq", problem), lambda: require_solver("dapq")):
        with pytest.raises(ConfigurationError, match=r"solver\.name = 'dapq'.*did you mean 'daqp'.*osqp, .*proxqp"):
            call()


@pytest.mark.parametrize("name", SOLVERS)
def test_all_solvers_agree_on_the_standing_robot(bench, name):
    reference = bench("g1")
    other = bench("g1", solver={"name": name})
    rng = np.random.default_rng(8)
    for _ in range(4):
        state = reference.near_stance(rng, position=0.05, velocity=0.1)
        references = reference.references()
        expected = reference.controller.solve(state, references)
        answer = other.controller.solve(state, references)
        solver = make_solver(name, other.controller.formulation.build(state, references).problem)
        assert max(answer.residuals.values()) <= max(1.0e-2, solver.tolerance)
        scale = max(1.0, np.abs(expected.v_dot).max())
        # OSQP, with its tolerance of 1e-3, is 11 to 13 times as inaccurate in the worst of 30 such states.
        assert np.abs(answer.v_dot - expected.v_dot).max() <= 15.0 * max(solver.tolerance, 1.0e-5) * scale
        # Internal forces between the feet have little cost: only exact solvers agree on them.
        if name in ("daqp", "proxqp", "quadprog"):
            assert np.abs(answer.tau - expected.tau).max() <= 1.0e-2


@pytest.mark.parametrize("seed", range(4))
def test_active_set_is_accepted_only_if_right(seed):
    """The right set is accepted; none, all, or wrong sides only if they are the right set."""
    problem = random_problem(np.random.default_rng(seed))
    expected = reference_answer(problem)
    answer = make_solver("daqp", problem).solve(problem)
    active_set = active_set_of(problem)
    active_set.adopt_multipliers(answer.multipliers)
    guessed = active_set.solve(problem)
    assert guessed.iterations == 1
    np.testing.assert_allclose(guessed.x, expected, atol=1e-7)
    np.testing.assert_allclose(guessed.multipliers, answer.multipliers, atol=1e-6)
    assert guessed.multipliers.any()
    for wrong in (0.0 * guessed.multipliers, -guessed.multipliers, np.where(guessed.multipliers == 0.0, 0.0, 1.0)):
        if (np.sign(wrong) != np.sign(guessed.multipliers)).any():
            active_set.adopt_multipliers(wrong)
            assert active_set.solve(problem) is None


def active_set_of(problem):
    return ActiveSet(problem.n, len(problem.b), len(problem.upper))


def test_active_set_is_followed_or_refused():
    rng = np.random.default_rng(7)
    problem = random_problem(rng)
    active_set = active_set_of(problem)
    active_set.adopt_multipliers(make_solver("daqp", problem).solve(problem).multipliers)
    found = [active_set.solve(problem := drift(problem, rng, size=0.001)) for _ in range(25)]
    assert sum(answer is not None for answer in found) >= 23
    problem = random_problem(np.random.default_rng(0))
    active_set = active_set_of(problem)
    active_set.adopt_multipliers(np.ones(len(problem.g) + len(problem.upper)))
    assert active_set.solve(problem) is None
    problem.A[1] = problem.A[0]  # singular system
    active_set.adopt_multipliers(np.zeros(len(problem.g) + len(problem.upper)))
    assert active_set.solve(problem) is None


#: Seeds of feasible problems that DAQP with default settings reports as infeasible, or cycles on.
CORNERS = {"g1": (607, 1855, 3335, 3791, 5018, 6347), "talos": (9195,), "go2": (6507, 7419, 7559, 11695)}


@pytest.mark.parametrize(("robot", "seed"), [(robot, seed) for robot, seeds in CORNERS.items() for seed in seeds])
def test_feasible_problem_is_not_reported_as_infeasible(bench, robot, seed):
    """Joints near their limits with different weights: the solution is in a corner. quadprog is the reference."""
    robot = bench(robot)
    problem = robot.controller.formulation.build(*robot.random_problem(seed)).problem
    assert feasibility_margin(problem) > 1.0e-5
    solver = make_solver("daqp", problem)
    answer = solver.solve(problem)
    assert answer.x is not None, answer.status
    assert problem.residuals(answer.x).violation <= solver.tolerance
    least = problem.cost.value(reference_answer(problem, tolerance=1.0e-7 * np.abs(problem.g).max()))
    assert problem.cost.value(answer.x) - least <= 1.0e-4 * least
    np.testing.assert_array_equal(make_solver("daqp", problem).solve(problem).x, answer.x)  # identical


@pytest.mark.parametrize("seed", range(3))
def test_soft_constraints_equal_slack_variables(seed):
    """Compared with a program with slack variables."""
    rng = np.random.default_rng(seed)
    problem, k = random_problem(rng), 6
    n, places = problem.n, np.sort(rng.choice(problem.n + len(problem.upper), k, replace=False))
    soft = SoftConstraints(places, np.array([[2.0], [3.0]]) + rng.normal(size=k), 10.0 ** rng.uniform(-1, 3, k))
    problem.bounds[:, places] = [[-np.inf], [np.inf]]
    answer = solve_carefully(problem, soft)
    whole = QuadraticProgram.empty(n + k, len(problem.b), len(problem.upper) + k)
    whole.H[:n, :n], whole.H[n:, n:], whole.g[:n] = problem.H, np.diag(soft.weights), problem.g
    whole.A[:, :n], whole.b[:] = problem.A, problem.b
    whole.C[:-k, :n], whole.C[-k:, :n], whole.C[-k:, n:] = problem.C, problem.rows(places), np.eye(k)
    whole.bounds[:, :n], whole.bounds[:, n + k : -k] = problem.bounds[:, :n], problem.bounds[:, n:]
    whole.bounds[:, -k:] = soft.bounds
    expected = reference_answer(whole)
    np.testing.assert_allclose(answer.x, expected[:n], atol=1e-6)
    np.testing.assert_allclose(np.abs(answer.multipliers[places]), soft.weights * np.abs(expected[n:]), atol=1e-4)
    assert (np.abs(expected[n:]) > 1e-3).any()


def test_soft_constraints_do_not_make_an_infeasible_problem_feasible():
    problem = random_problem(np.random.default_rng(0))
    problem.x_lower[0], problem.x_upper[0] = 1.0, -1.0
    answer = solve_carefully(problem, SoftConstraints(np.array([1]), np.zeros((2, 1)), np.ones(1)))
    assert (answer.x, answer.status) == (None, "infeasible")
