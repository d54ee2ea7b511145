"""Compare the solvers on the controller's own problems, for the choice of the default.

Every problem is solved by each solver in turn, so that disturbances affect all equally; compare the ratios.

    python benchmarks/solvers.py            the persistent back ends
    python benchmarks/solvers.py quadprog   and any other solver of qpsolvers
"""

import sys
import time
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.formulation.problem import Answer
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings.files import find_configuration, load_settings

ROBOTS = ("g1", "talos", "go2")
PROBLEMS = 500


def swaying(model: RobotModel, seed: int = 0) -> Iterator[RobotState]:
    """Return adjacent states for a warm start: a slow motion of all joints around the nominal posture."""
    direction = 0.01 * np.random.default_rng(seed).normal(size=model.nv)
    start = model.configuration(model.posture)
    for i in range(PROBLEMS):
        phase = 0.02 * i
        q = pin.integrate(model.pinocchio, start, np.sin(phase) * direction)
        yield RobotState(0, frozen(q), frozen(5.0 * np.cos(phase) * direction))


def measure(robot: str, solvers: list[str]) -> None:
    """Print one table."""
    settings = load_settings(find_configuration(robot))
    model = make_model(settings)
    controller = make_qp(settings, model)
    controller.dynamics.update(model.configuration(model.posture), np.zeros(model.nv))
    board = make_board(settings, controller)
    board.reset(controller.dynamics, 0.0)
    references = board.sample(1.0)
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    failures = dict.fromkeys(solvers, 0)
    difference = dict.fromkeys(solvers, 0.0)
    made = {}
    for state in swaying(model):
        problem = controller.formulation.build(state, references).problem
        best: Answer | None = None
        for name in solvers:
            if name not in made:
                made[name] = make_solver(name, problem)
            before = time.perf_counter()
            answer = made[name].solve(problem)
            seconds[name].append(time.perf_counter() - before)
            best = best or answer
            if answer.x is None or best.x is None:
                failures[name] += 1
            else:
                difference[name] = max(difference[name], float(np.max(np.abs(answer.x - best.x)[: model.nv])))
    print(f"\n{robot}: {problem.n} unknowns, {len(problem.b)} equalities, {len(problem.upper)} two-sided rows")
    print(f"{'solver':12}{'median':>10}{'p99':>10}{'ratio':>8}{'failures':>10}   largest difference in v̇")
    first = np.median(seconds[solvers[0]])
    for name in solvers:
        median, p99 = np.quantile(seconds[name], (0.5, 0.99))
        print(
            f"{name:12}{1e6 * median:7.0f} us{1e6 * p99:7.0f} us{median / first:8.2f}{failures[name]:10}"
            f"   {difference[name]:.1e}"
        )


if __name__ == "__main__":
    for name in ROBOTS:
        measure(name, ["daqp", "proxqp", "osqp", *sys.argv[1:]])
