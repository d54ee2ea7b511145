"""Fuzzer of quadratic programs."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.errors import NoSolution, WbcError
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.formulation.relaxation import Relaxable, relaxations, soften
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array, References, RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

_MARGIN = 1.0e-6  # margin of an infeasible problem, in its units
NO_SOLUTION = "no solution"
Problem = tuple[RobotState, References, Array | None]  # with previous torques


@dataclass(frozen=True, slots=True)
class SolvedProblem:
    """One problem."""

    robot: str
    number: int
    relaxed: str  # relaxed groups, or `NO_SOLUTION`
    seconds: float  # processor time of the answer, s
    failure: str  # error of the answer, or empty

    @property
    def failed(self) -> bool:
        """True if the answer is wrong."""
        return bool(self.failure)

    def __str__(self) -> str:
        return f"{self.robot}, problem {self.number}: {self.relaxed}"


def fuzz_problems(robots: Sequence[str], numbers: Sequence[int], seed: int) -> Iterator[SolvedProblem]:
    """Solve random problems of each robot, and check the relaxations; `seed` plus the number determines a problem."""
    for robot in robots:
        qp, draw = problems_of(robot)
        for number in numbers:
            arguments = draw(seed + number)
            started = time.thread_time()
            try:
                relaxed = qp.solve(*arguments, explained=False).relaxed
            except NoSolution:
                relaxed = (NO_SOLUTION,)
            seconds = time.thread_time() - started
            failure = relaxation_error(qp, arguments, relaxed) or ""
            yield SolvedProblem(robot, number, ", ".join(relaxed) or "nothing relaxed", seconds, failure)


def problems_of(robot: str) -> tuple[WholeBodyQP, Callable[[int], Problem]]:
    """Return the quadratic program of a standing robot, and a function that draws its problems by seed."""
    settings = load_settings(find_configuration(robot))
    qp = make_qp(settings, make_model(settings))
    standing = stance(qp.model, qp, list(qp.contacts))
    references = rest(qp, settings, RobotState(0, frozen(standing), frozen(np.zeros(qp.model.nv))))
    return qp, partial(random_problem, qp.model, standing, references)


def summary(problems: Sequence[SolvedProblem]) -> Iterator[str]:
    """Yield a line for each robot, and for each wrong answer."""
    for robot in dict.fromkeys(problem.robot for problem in problems):
        own = [problem for problem in problems if problem.robot == robot]
        counts = Counter(problem.relaxed for problem in own).most_common()
        failed = [problem for problem in own if problem.failed]
        yield (
            f"{robot:10} {len(own)} problems ({', '.join(f'{name}: {count}' for name, count in counts)}); falsely "
            f"infeasible or relaxed too much: {len(failed)}; slowest answer "
            f"{1e3 * max(problem.seconds for problem in own):.1f} ms of processor time"
        )
        yield from (f"  problem {problem.number}: {problem.failure}" for problem in failed)


def rest(qp: WholeBodyQP, settings: Settings, state: RobotState) -> References:
    """Return references at rest in a state, with the configured weights and all contacts active."""
    dynamics = Dynamics(qp.model)
    dynamics.update(state.q, state.v)
    return References(
        tasks={name: task.rest(dynamics) for name, task in qp.tasks.items()},
        weights={name: task.weight if task.enabled else 0.0 for name, task in settings.tasks.items()},
        contacts=dict.fromkeys(qp.contacts, 1.0),
    )


def random_problem(model: RobotModel, standing: Array, references: References, seed: int) -> Problem:
    """Return a random state, references, and previous torques.

    A quarter of the joints is 0.1 to 100 mrad from a limit. Odd seeds scale the weights by 10^-2 to 10^2; half of the
    seeds have previous torques. `standing` is q, (nq,).
    """
    rng = np.random.default_rng(seed)
    lower, upper = model.position_lower + 0.02, model.position_upper - 0.02
    q = pin.integrate(model.pinocchio, standing, 0.3 * rng.uniform(-1, 1, model.nv))
    near, high = rng.random(model.nj) < 0.25, rng.random(model.nj) < 0.5
    gap = 10.0 ** rng.uniform(-4, -1, model.nj)
    joints = np.where(high, upper - gap, lower + gap)
    q[model.q_index] = np.where(near, joints, np.clip(q[model.q_index], lower, upper))
    state = RobotState(0, frozen(q), frozen(10.0 ** rng.uniform(-2, 0.3) * rng.uniform(-1, 1, model.nv)))
    before = None
    if seed % 2:
        weights = {name: weight * 10.0 ** rng.uniform(-2, 2) for name, weight in references.weights.items()}
        references = replace(references, weights=weights)
    if seed // 2 % 2:
        before = model.effort_limits * rng.uniform(-0.2, 0.2, model.na)
    return state, references, before


def relaxation_error(qp: WholeBodyQP, arguments: Problem, relaxed: Sequence[str]) -> str | None:
    """Return the error of a relaxation, with `NO_SOLUTION` for no solution, or None if it was necessary."""
    if not relaxed:
        return None
    layout = qp.formulation.build(*arguments)
    *rate, everything = relaxations(qp.formulation, layout, arguments[1])
    result = "no solution was found" if NO_SOLUTION in relaxed else f"{', '.join(relaxed)} was relaxed"
    steps: list[tuple[Sequence[Relaxable], str]] = [((), "")]  # groups to soften in order, and text
    if tuple(relaxed) != ("torque_rate",):
        steps += [(groups, " without the torque rate") for groups in rate]
    if NO_SOLUTION in relaxed:
        steps.append((everything, " with everything relaxed"))
    for groups, without in steps:
        if groups:
            soften(layout, groups)
        largest_margin = feasibility_margin(layout.problem)
        if largest_margin > _MARGIN:
            return f"feasible with a margin of {largest_margin:.3g}{without}, but {result}"
    return None


def feasibility_margin(problem: QuadraticProgram) -> float:
    """Return the largest distance of a solution x from all bounds, at most 1, by a linear program.

    It is negative for infeasible problems.
    """
    n, (lower, upper) = problem.n, problem.bounds
    rows = np.vstack([np.eye(n), problem.C])
    above, below = np.isfinite(upper), np.isfinite(lower)
    G, h = np.vstack([rows[above], -rows[below]]), np.concatenate([upper[above], -lower[below]])
    unequal, equal = (np.c_[G, np.ones(len(G))], h), (np.c_[problem.A, np.zeros(len(problem.A))], problem.b)
    cost, limits = np.append(np.zeros(n), -1.0), [(None, None)] * n + [(None, 1.0)]
    for method in ("highs-ds", "highs-ipm"):
        result = linprog(cost, *unequal, *equal, limits, method=method)
        if result.status == 0:
            return float(result.x[-1])
    raise WbcError(f"the linear program failed: {result.message}")
