"""State of the formulation between cycles, and compiled rows against the classes' own rows."""

import numpy as np
import pytest

from wbc_controller.inverse_dynamics.contacts import PointContact, SurfaceContact
from wbc_controller.inverse_dynamics.tasks import ComTask, FrameOrientationTask, PostureTask
from wbc_controller.records import frozen


def numbers(robot, state, before=None):
    """Return all numbers for a solver."""
    problem = robot.controller.formulation.build(state, robot.references(state), before).problem
    return np.concatenate(
        [problem.memory[problem.room :].ravel(), problem.bounds.ravel(), problem.H.ravel(), problem.g]
    )


def first_contact(formulation):
    return next(iter(formulation.contacts.values()))


#: Parameters that may be set between two cycles.
SETTINGS = {
    "largest normal force": lambda of: setattr(first_contact(of), "max_normal_force", 77.0),
    "smallest normal force": lambda of: setattr(first_contact(of), "min_normal_force", 11.0),
    "damping of the centre of mass": lambda of: setattr(of.tasks["com"], "damping", np.full(3, 3.0)),
    "damping of joints": lambda of: setattr(of.tasks["posture"], "damping", np.full(of.tasks["posture"].size, 3.0)),
    "torque rate": lambda of: setattr(of.torque_limit, "rate", 0.5),
    "effort limits": lambda of: setattr(of.torque_limit, "effort_limits", frozen(0.5 * of.torque_limit.effort_limits)),
    "acceleration": lambda of: setattr(of.motion_limit, "acceleration", 7.0),
}


@pytest.mark.parametrize("what", SETTINGS)
@pytest.mark.parametrize("name", ["g1", "go2"])
def test_attribute_changes_apply_in_the_next_cycle(bench, name, what):
    late, early = bench(name), bench(name)
    rng = np.random.default_rng(3)
    state, before = late.near_stance(rng), np.zeros(late.model.na)
    without = numbers(late, state, before)
    for robot in (late, early):
        SETTINGS[what](robot.controller.formulation)
    found = numbers(late, state, before)
    np.testing.assert_array_equal(found, numbers(early, state, before))
    assert (found != without).any()
    np.testing.assert_array_equal(numbers(late, state, before), found)


def plain(thing):
    """Return an instance of a subclass, the rows of which are evaluated in Python."""
    thing.__class__ = type(f"Own{type(thing).__name__}", (type(thing),), {})
    assert thing.instruction() is None


@pytest.mark.parametrize("name", ["g1", "talos", "go2"])
def test_compiled_rows_equal_the_classes(bench, name):
    compiled, own = bench(name), bench(name)
    formulation = own.controller.formulation
    kinds = set()
    for thing in (*formulation.tasks.values(), *formulation.contacts.values()):
        kinds.add(type(thing))
        plain(thing)
    assert kinds >= {ComTask, FrameOrientationTask, PostureTask, PointContact if name == "go2" else SurfaceContact}
    rng = np.random.default_rng(5)
    for _ in range(10):
        state, before = compiled.near_stance(rng), rng.normal(size=compiled.model.na)
        expected = numbers(own, state, before)
        np.testing.assert_allclose(numbers(compiled, state, before), expected, rtol=1e-9, atol=1e-7)
        solutions = [robot.controller.solve(state, robot.references(state), before) for robot in (compiled, own)]
        errors = [solution.task_errors for solution in solutions]
        assert errors[0].keys() == errors[1].keys()
        for task, error in errors[1].items():
            assert errors[0][task] == pytest.approx(error, abs=1e-9)
