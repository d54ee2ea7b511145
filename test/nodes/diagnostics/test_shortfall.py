"""Reports of unreachable references with the binding constraints, and none during an approach."""

from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.controller.controller import Controller
from wbc_controller.nodes.diagnostics.task_reports import Shortfall, _distance, describe_binding, describe_constraint

PERIOD = 0.1


@pytest.fixture(scope="module")
def controller():
    return Controller("go2")


def said(controller, goal, *, times, binding, weight=50.0, velocity=0.0, approach=0.0):
    """Return the last report's sentences with a com reference `far` away, after the share `approach` of the error."""
    shortfall, dynamics = Shortfall({"com": controller.tasks["com"]}), controller.dynamics
    found = ()
    for i in range(times):
        left = 1.0 - approach * i / times
        reference = SimpleNamespace(position=dynamics.com + left * np.array(goal), velocity=np.full(3, velocity))
        references = SimpleNamespace(tasks={"com": reference}, weights={"com": weight, "base": 5.0})
        solution = SimpleNamespace(binding=binding, task_errors={"com": left * np.linalg.norm(goal)})
        found = shortfall.sentences(i * PERIOD, dynamics, references, solution)
    return found


def test_a_persistent_error_is_reported_with_binding_constraints(controller):
    binding = {"motion:FL_calf_joint:upper": 3.0, "torque:RL_thigh_joint:lower": 0.5, "cone:front_left_foot": 1.0e-6}
    (sentence,) = said(controller, [0.0, 0.0, 0.035], times=12, binding=binding)
    assert sentence == (
        "com is 35 mm short of its reference; binding: FL_calf_joint's upper limit of motion, "
        "RL_thigh_joint's lower torque limit"
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"times": 10},  # too short
        {"goal": [0.0, 0.0, 0.009]},  # near the reference
        {"velocity": 0.1},  # in motion
        {"approach": 0.5},  # approaching
        {"weight": 0.04},  # minor weight
    ],
)
def test_no_shortfall(controller, changes):
    assert said(controller, **{"goal": [0.0, 0.0, 0.035], "times": 12, "binding": {}, **changes}) == ()


def test_distances_and_binding_constraints_in_words():
    assert _distance(np.array([0.03, 0.0, 0.04, 0.0, 0.1, 0.0]), "m, rad") == "50 mm and 0.10 rad"
    assert _distance(np.array([0.03, 0.0, 0.04, 0.0, 0.01, 0.0]), "m, rad") == "50 mm"
    assert _distance(np.array([0.0, 0.1, 0.0]), "rad") == "0.10 rad"
    assert describe_binding({}) == "none; other tasks or forces outweigh it"
    assert describe_binding({f"rows:{i}": 1.0 for i in range(5)}) == "rows:0, rows:1, rows:2, and 2 more"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("torque:left_ankle_pitch_joint:lower", "left_ankle_pitch_joint's lower torque limit"),
        ("normal_force:left_foot:lower", "left_foot's smallest normal force"),
        ("cone:left_foot", "left_foot's friction, or the edge of its support"),
        ("self_collision:a/b", "self_collision:a/b"),
    ],
)
def test_constraints_in_words(name, words):
    assert describe_constraint(name) == words
