"""Measure the cost of self-collision avoidance: the same cycles with and without the limit, in turn.

The hands move from side to side in front of the robot at given speeds. Run: python benchmarks/self_collision.py
"""

import time
from dataclasses import replace

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import References, RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

SRDF = {"g1": "", "talos": "package://example-robot-data/robots/talos_data/srdf/talos.srdf"}
HANDS = ("left_hand", "right_hand")
CYCLES = 400


def controllers(name: str) -> tuple[Settings, RobotModel, dict[str, WholeBodyQP]]:
    """Return a robot's controllers, without and with the limit."""
    settings = load_settings(find_configuration(name))
    model, found = make_model(settings), {}
    for what, enabled in (("without", False), ("with", True)):
        own = settings.limits.self_collision.model_copy(update={"enabled": enabled, "srdf": SRDF[name]})
        limits = settings.limits.model_copy(update={"self_collision": own})
        found[what] = make_qp(settings.model_copy(update={"limits": limits}), model)
    return settings, model, found


def measure(name: str, speed: float) -> None:
    """Print the median cycle and building times, with hands of a peak speed in m/s."""
    settings, model, found = controllers(name)
    first = found["without"]
    q = stance(model, first, list(first.contacts))
    v, period = np.zeros(model.nv), first.formulation.period
    first.dynamics.update(q, v)
    tasks = {task: first.tasks[task].rest(first.dynamics) for task in first.tasks}
    weights = {task: values.weight if values.enabled else 0.0 for task, values in settings.tasks.items()}
    seconds: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
    rows = []
    for cycle in range(CYCLES):
        frequency = 2.0 * np.pi
        targets = dict(tasks)
        for hand in HANDS:
            move = np.zeros(len(tasks[hand].position))
            move[1] = speed / frequency * np.sin(frequency * cycle * period)
            velocity = np.zeros(len(tasks[hand].velocity))
            velocity[1] = speed * np.cos(frequency * cycle * period)
            targets[hand] = replace(tasks[hand], position=tasks[hand].position + move, velocity=velocity)
        references = References(targets, weights, dict.fromkeys(first.contacts, 1.0))
        state = RobotState(0, frozen(q), frozen(v))
        for what in ("without", "with") if cycle % 2 else ("with", "without"):
            started = time.perf_counter()
            solution = found[what].solve(state, references)
            seconds[what].append((time.perf_counter() - started, solution.stage_seconds["build"]))
            if what == "with":
                answer = solution
        (limit,) = found["with"].formulation.row_limits
        rows.append(sum(not label.endswith(":unused") for label in limit.names))
        q = pin.integrate(model.pinocchio, q, period * v + 0.5 * period**2 * answer.v_dot)
        v = v + period * answer.v_dot
    medians = {what: 1e6 * np.median(times, axis=0) for what, times in seconds.items()}
    plain, cycle = medians["without"][0], medians["with"][0]
    build = medians["with"][1] - medians["without"][1]
    print(
        f"{name:6} hands at {speed:3.1f} m/s: cycle {plain:5.0f} us without, {cycle:5.0f} us with ({cycle / plain:.2f} "
        f"times), {build:4.0f} us of them to build the problem; {np.mean(rows):4.1f} rows"
    )


def main() -> None:
    """Measure both humanoids at rest and in motion."""
    for name in SRDF:
        for speed in (0.0, 0.5, 1.5):
            measure(name, speed)


if __name__ == "__main__":
    main()
