"""The whole cycle of ours beside tsid's, on the same states of Talos, and whether the two answer alike.

Double support; centre of mass, posture and orientation of the base as tasks with the same gains and weights; the same
feet, friction and torque limits. Ours is everything from a frozen state to a checked command: `Controller.solve`, which
checks every constraint at its answer, and the supervisor, with the torque rate, which tsid has not. The mappings of a
solution, such as what binds and at which cost, are made when somebody reads them: the commands do not wait for it, and
they are not in the time. tsid's is `computeProblemData`, `solve` and `getActuatorForces`. The states are those of a
centre of mass that sways by 3 cm, 1 ms apart. The two take turns in blocks (A B A B) on the same processor, where there
is a choice, so that the machine's moods and neighbours meet both: compare the ratio.

    python benchmarks/against_tsid.py
"""

from __future__ import annotations

import dataclasses
import gc
import math
import os
import time

import numpy as np
import pinocchio as pin
from our_cycle import DAMPING, STIFFNESS, WEIGHTS, Cycle, state_of, talos, tsids_tasks
from tsid_process import Tsid

from wbc_controller.assembly.preflight import stance
from wbc_controller.assembly.robot import make_model
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.records import Array, Reference, References, RobotState, frozen
from wbc_controller.settings import Settings

PERIOD = 0.001
STATES, BLOCK = 2000, 200
#: How far and how often the centre of mass sways, m and 1/s, along x and y.
SWAY, FREQUENCY = np.array([0.01, 0.03, 0.0]), 0.5

Case = tuple[RobotState, References]


def swaying(cycle: Cycle, model: RobotModel, q: Array) -> list[Case]:
    """States along the motion that our answers make, without a simulator, and the references in each."""
    rest = cycle.start(q)
    v = np.zeros(model.nv)
    com = rest.tasks["com"].position
    cases = []
    for i in range(STATES):
        rate = 2.0 * math.pi * FREQUENCY
        phase, started = rate * PERIOD * i, min(1.0, PERIOD * i / 0.5)
        reference = Reference(
            frozen(com + started * math.sin(phase) * SWAY),
            frozen(started * rate * math.cos(phase) * SWAY),
            frozen(-started * rate**2 * math.sin(phase) * SWAY),
        )
        references = dataclasses.replace(rest, tasks={**rest.tasks, "com": reference})
        state = state_of(q, v)
        cases.append((state, references))
        v_dot = cycle.controller.solve(state, references).v_dot
        q = pin.integrate(model.pinocchio, q, PERIOD * v + 0.5 * PERIOD**2 * v_dot)
        v = v + PERIOD * v_dot
    return cases


def rows_of(cases: list[Case]) -> Array:
    """The same for tsid, (n, nq + nv + 9)."""
    coms = [references.tasks["com"] for _, references in cases]
    return np.array(
        [
            np.concatenate([state.q, state.v, com.position, com.velocity, com.acceleration])
            for (state, _), com in zip(cases, coms, strict=True)
        ]
    )


def compare(cycle: Cycle, model: RobotModel, cases: list[Case], process: Tsid) -> None:
    """Print how far the answers are from each other."""
    v_dots, taus, wrenches, _ = process.solve(rows_of(cases))
    worst = dict.fromkeys(("v_dot", "tau", "together", "each", "cost"), 0.0)
    for (state, references), v_dot, tau, wrench in zip(cases, v_dots, taus, wrenches, strict=True):
        answer = cycle.controller.solve(state, references)
        dynamics = cycle.controller.dynamics
        feet = cycle.controller.contacts.values()
        forces = [answer.forces[foot.name] for foot in feet]
        ours = [foot.wrench_in_world(dynamics, force) for foot, force in zip(feet, forces, strict=True)]
        theirs = [foot.wrench_in_world(dynamics, force) for foot, force in zip(feet, wrench, strict=True)]
        costs = [cost(cycle, references, answer.v_dot), cost(cycle, references, v_dot)]
        found = {
            "v_dot": np.abs(answer.v_dot - v_dot).max(),
            "tau": np.abs(answer.tau - tau[model.v_index - 6]).max(),
            "together": np.abs(sum(ours) - sum(theirs)).max(),
            "each": np.abs(np.array(forces) - wrench).max(),
            "cost": abs(costs[0] - costs[1]) / max(*costs, 1.0),
        }
        worst = {key: max(value, float(found[key])) for key, value in worst.items()}
    print(f"largest difference in {len(cases)} states:")
    print(
        f"  v̇                  {worst['v_dot']:10.2e} m/s², rad/s²    cost of the tasks, relative {worst['cost']:.1e}"
    )
    print(f"  contact wrenches   {worst['together']:10.2e} N, N·m          their sum")
    print(f"                     {worst['each']:10.2e} N, N·m          each foot's")
    print(f"  τ                  {worst['tau']:10.2e} N·m")
    print(
        "The tasks leave no freedom in v̇ and so none in the sum of the wrenches: what differs there is what each pays\n"
        "for its regularization of the forces (with tsid's at its usual weight of 1e-5, a hundred times as much). How\n"
        "the two feet share that sum and press against each other is free, and the torques follow: ours takes the\n"
        "smallest wrenches, tsid, with four forces per foot, weighs the normal ones 1e-3 and the moments 2."
    )


def cost(cycle: Cycle, references: References, v_dot: Array) -> float:
    """Σ w ‖J v̇ - b‖² of the tasks, in the state of the controller's last cycle."""
    total = 0.0
    for name, task in cycle.controller.tasks.items():
        J, right, _ = task.equation(cycle.controller.dynamics, references.tasks[name])
        total += references.weights[name] * float(np.sum((J @ v_dot - right) ** 2))
    return total


def measure(settings: Settings) -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # tsid's process inherits it
    model = make_model(settings)
    cycle = Cycle(settings, model)
    q = stance(model, cycle.controller, list(cycle.controller.contacts))
    cases = swaying(Cycle(settings, model), model, q)
    cycle.start(q)
    with Tsid(settings, model, q, WEIGHTS, stiffness=STIFFNESS, damping=DAMPING, waist="base_link") as process:
        problem = cycle.controller.formulation.build(*cases[0]).problem
        print("\ntalos, double support: centre of mass, posture, base orientation, torque limits; one cycle")
        print(f"  ours: {problem.n} unknowns, {len(problem.b)} equalities, {len(problem.upper)} two-sided rows")
        print(f"  tsid: {process.unknowns} unknowns, {process.equalities} equalities, {process.inequalities} rows")
        ours: list[float] = []
        tsids: list[float] = []
        stages: dict[str, list[float]] = {}
        ratios = []
        gc.disable()
        for start in range(0, STATES, BLOCK):
            block = cases[start : start + BLOCK]
            seconds = []
            for state, references in block:
                before = time.perf_counter()
                cycle.step(state, references)
                seconds.append(time.perf_counter() - before)
                if cycle.solution is not None:
                    for stage, value in cycle.solution.stage_seconds.items():
                        stages.setdefault(stage, []).append(value)
            theirs = process.solve(rows_of(block))[3].tolist()
            ratios.append(np.median(seconds) / np.median(theirs))
            ours += seconds
            tsids += theirs
        gc.enable()
        print(f"{'':12}{'median':>10}{'p99':>10}{'ratio':>8}   ratio of each pair of blocks")
        base = np.median(tsids)
        low, high = min(ratios), max(ratios)
        for name, values, spread in (("tsid", tsids, ""), ("ours", ours, f"{low:.2f} to {high:.2f}")):
            median, p99 = np.quantile(values, (0.5, 0.99))
            print(f"{name:12}{1e6 * median:7.0f} us{1e6 * p99:7.0f} us{median / base:8.2f}   {spread}")
        parts = ", ".join(f"{stage} {1e6 * np.median(values):.0f}" for stage, values in stages.items())
        print(f"ours in parts: {parts} us, the supervisor's checks the rest")
        compare(cycle, model, cases[:: BLOCK // 4], process)


if __name__ == "__main__":
    # The limits of joint motion that tsid has not in this case are off. Our regularization of the forces is as weak as
    # its is, so that the answers can be compared.
    limits, solver = {"position": False, "velocity": False}, {"regularization_force": 1.0e-8}
    measure(talos(tsids_tasks(), limits=limits, solver=solver))
