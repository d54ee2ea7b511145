"""Reports on tasks: unreachable references with the binding constraints, values and references as messages."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.controller import Controller
from wbc_controller.inverse_dynamics.tasks import AccelerationTask
from wbc_controller.middleware.codec import encode, setpoint_message
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.nodes.diagnostics import task_reports
from wbc_controller.nodes.wiring import make_vocabulary

PERIOD = 0.1


@pytest.fixture(scope="module")
def controller():
    return Controller("go2")


def said(controller, goal, *, times, binding, weight=50.0, velocity=0.0, approach=0.0):
    """Return the last report's sentences with a com reference `far` away, after the share `approach` of the error."""
    shortfall, dynamics = task_reports.Shortfall({"com": controller.tasks["com"]}), controller.dynamics
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
    assert task_reports._distance(np.array([0.03, 0.0, 0.04, 0.0, 0.1, 0.0]), "m, rad") == "50 mm and 0.10 rad"
    assert task_reports._distance(np.array([0.03, 0.0, 0.04, 0.0, 0.01, 0.0]), "m, rad") == "50 mm"
    assert task_reports._distance(np.array([0.0, 0.1, 0.0]), "rad") == "0.10 rad"
    assert task_reports.describe_binding({}) == "none; other tasks or forces outweigh it"
    assert task_reports.describe_binding({f"rows:{i}": 1.0 for i in range(5)}) == "rows:0, rows:1, rows:2, and 2 more"


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
    assert task_reports.describe_constraint(name) == words


@pytest.mark.parametrize("robot", ["g1", "talos", "go2"])
def test_each_round_contains_reference_and_value_of_every_task(robot, robot_of, changed):
    """With the frame of a task with relative references, and in a later round."""
    settings, model = robot_of(robot)
    feet = [contact.frame for contact in settings.contacts.values()][:2]
    held = {"type": "relative_pose", "frame": feet[0], "reference_frame": feet[1]}
    settings = changed(settings, {"tasks": {"feet": held}})
    qp = make_qp(settings, model)
    dynamics, board = qp.dynamics, make_board(settings, qp)
    words = make_vocabulary(settings, model)
    assert set(words.reference_frames) == {"feet"}
    states = task_reports.TaskStates(qp.tasks, words)
    rng = np.random.default_rng(3)
    for stamp in (5, 7_000_000_003):
        q = pin.integrate(model.pinocchio, model.configuration(model.posture), 0.1 * rng.normal(size=model.nv))
        dynamics.update(q, np.zeros(model.nv))
        board.reset(dynamics, 0.0)
        references = board.sample(0.0)
        dynamics.update(pin.integrate(model.pinocchio, q, 0.1 * rng.normal(size=model.nv)), np.zeros(model.nv))
        expected = {}
        for name, kind in words.kinds.items():
            positions = {"task_reference": references.tasks[name].position}
            if isinstance(qp.tasks[name], AccelerationTask):
                positions["task_value"] = qp.tasks[name].position(dynamics)
            frame, joints = words.reference_frames.get(name, "world"), words.joints.get(name, ())
            type_name = TASK_TYPES[kind]["setpoint"]
            made = partial(setpoint_message, type_name, kind, frame=frame, stamp=stamp, joints=joints)
            expected[name] = {key: encode(made(position)) for key, position in positions.items()}
        states.begin(words.kinds)
        assert dict(iter(lambda: states.next(stamp, dynamics, references), None)) == expected  # noqa: B023
        states.begin(("feet", "nothing"))
        assert states.next(stamp, dynamics, references) == ("feet", expected["feet"])
        assert states.next(stamp, dynamics, references) is None
