"""The fast formulation against the plain quadratic program, on random problems of six robots.

``PLAIN_QP_PROBLEMS=10000 pytest test/inverse_dynamics/formulation/test_plain_qp.py`` runs more problems.
"""

import os
from functools import cache, partial

import numpy as np
import pinocchio as pin
import pytest
from chains import MENAGERIE, menagerie
from snapshots import dynamics_at

from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.contacts import AnchoredContact
from wbc_controller.inverse_dynamics.formulation.plain_qp import Limits, plain_qp, task_rows
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import (
    AngularMomentumTask,
    CapturePointTask,
    ContactWrenchTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    PostureTask,
    TorqueTask,
)
from wbc_controller.records import Disturbance, Reference, References, RobotState, frozen
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.validation.fuzz import hostile_classes

PROBLEMS = int(os.environ.get("PLAIN_QP_PROBLEMS", "200"))
#: Legs without hip abduction: at least one row of four feet depends on the others.
SOLO_8 = "package://example-robot-data/robots/solo_description/robots/solo.urdf"
PANDA = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"


class Height(hostile_classes.Height):
    """User-defined task with a priority level and a tolerance."""

    def __init__(self, model, name="height", level=0, tolerance=None):
        super().__init__(model, name)
        self.level, self.tolerance = level, tolerance


class OwnPosture(PostureTask):
    """Posture task with rows evaluated in Python."""


def grip(model):
    """Return a held point of the last link."""
    return hostile_classes.Grip(model, model.pinocchio.frames[-1].name, np.array([[1.0, 0.5, -1.0]]), 3.0)


@cache
def settings_of(robot):
    if robot == "menagerie":
        return menagerie()
    drafted = {"panda": PANDA, "solo8": SOLO_8}
    return new_configuration(drafted[robot]).settings if robot in drafted else load_settings(find_configuration(robot))


def build(robot, *, levels):
    """Return a quadratic program with compiled tasks and contacts, and with others evaluated in Python."""
    settings = settings_of(robot)
    model = make_model(settings, MENAGERIE if robot == "menagerie" else None)
    joints, frame = model.driven_joints[:2], model.pinocchio.frames[-1].name
    tasks = [
        Height,
        lambda model: Height(model, "lower", level=1 if levels else 0),
        lambda model: PostureTask("same joints", model, joints),
        lambda model: OwnPosture("own posture", model, joints),
        lambda model: CapturePointTask("capture point", model.gravity, [False, True], support_height=-0.5),
        lambda model: CapturePointTask("lying", model.gravity, support_height=50.0),
        lambda model: AngularMomentumTask("momentum", [True] * 3, damping=5.0),
        lambda model: TorqueTask("torque", model, joints, (1.0, 2.0)),
        lambda model: FramePositionTask("position", model, frame, [True, False, True], stiffness=[10.0, 20.0, 30.0]),
        lambda model: FrameOrientationTask("orientation", model, frame, [False, True, True], damping=[1.0, 2.0, 3.0]),
        lambda model: FramePoseTask("pose", model, "universe"),
        lambda model: FramePoseTask("masked pose", model, frame, [True] * 2 + [False] * 2 + [True] * 2),
    ]
    if levels:
        tasks.append(lambda model: Height(model, "band", level=1, tolerance=np.array([0.02])))
    feet = make_qp(settings, model).contacts
    if feet:
        foot = next(iter(feet.values()))
        tasks.append(lambda model: ContactWrenchTask("wrench", foot, [True] * 6, np.full(6, 3.0)))
    return make_qp(settings, model, tasks=tasks, contacts=[grip], limits=[partial(hostile_classes.Ceiling, most=5.0)])


def random_state(model, rng):
    joints = rng.uniform(np.maximum(model.position_lower, -3.0), np.minimum(model.position_upper, 3.0))
    base = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) if model.floating_base else None
    return RobotState(0, model.configuration(joints, base), 10.0 ** rng.uniform(-2, 0.5) * rng.normal(size=model.nv))


def random_references(qp, rng):
    """Draw references, weights, activations, anchors, external forces, gains and limits."""
    elsewhere = random_state(qp.model, rng)
    there = dynamics_at(qp.model, elsewhere.q, elsewhere.v)
    tasks = {}
    for name, task in qp.tasks.items():
        rest = task.rest(there)
        tasks[name] = Reference(rest.position, rng.normal(size=len(rest.velocity)), rng.normal(size=len(rest.velocity)))
        if rng.random() < 0.2:
            for gain in task.gain_names:
                setattr(task, gain, rng.uniform(1.0, 100.0, task.size))
    formulation = qp.formulation
    if rng.random() < 0.2:
        formulation.motion_limit.acceleration = rng.uniform(20.0, 200.0)
        formulation.torque_limit.rate = rng.uniform(1.0, 100.0)
        formulation.torque_limit.effort_limits = frozen(qp.model.effort_limits * rng.uniform(0.5, 1.0))
        for contact in qp.contacts.values():
            contact.min_normal_force, contact.max_normal_force = rng.uniform(0.0, 50.0), rng.uniform(100.0, 900.0)
    sometimes = {
        "external_wrenches": {"universe": rng.normal(size=6), qp.model.pinocchio.frames[-1].name: rng.normal(size=6)},
        "disturbance": Disturbance(*rng.normal(size=(2, qp.model.nv))),
        "friction": {name: float(rng.choice([1.0, rng.uniform(0.05, 1.0)])) for name in qp.contacts},
    }
    return References(
        tasks=tasks,
        weights={name: 10.0 ** rng.uniform(-2, 3) if rng.random() < 0.8 else 0.0 for name in qp.tasks},
        contacts={name: float(rng.choice([0.0, 1.0, rng.random()])) for name in qp.contacts},
        anchors={
            name: contact.anchor(there) for name, contact in qp.contacts.items() if isinstance(contact, AnchoredContact)
        },
        **{key: value for key, value in sometimes.items() if rng.random() < 0.3},
    )


def near(name, found, expected):
    size = max(1.0, np.abs(expected[np.isfinite(expected)]).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * size, err_msg=name)


@pytest.mark.parametrize("levels", [False, True], ids=["one level", "levels"])
@pytest.mark.parametrize("robot", ["g1", "go2", "talos", "panda", "menagerie", "solo8"])
def test_fast_formulation_equals_the_plain_qp(robot, levels):
    qp = build(robot, levels=levels)
    formulation, rng = qp.formulation, np.random.default_rng(7)
    seen = Dynamics(qp.model)
    for _ in range(PROBLEMS // 10):
        state, references = random_state(qp.model, rng), random_references(qp, rng)
        before = qp.model.effort_limits * rng.uniform(-0.5, 0.5, qp.model.na) if rng.random() < 0.5 else None
        layout = formulation.build(state, references, before)
        limits = Limits(formulation.torque_limit, formulation.motion_limit, formulation.row_limits, formulation.period)
        seen.update(state.q, state.v)
        for number, level in enumerate(layout.levels):
            tasks = [task for task in qp.tasks.values() if task.level == number]
            exact = [task for task in tasks if task.tolerance is None]
            contacts = list(qp.contacts.values())
            expected = plain_qp(
                seen, exact, contacts, limits, references, before, formulation.regularization,
                first=number == 0,
            )  # fmt: skip
            near("H", level.cost.H, expected.H)
            near("g", level.cost.g, expected.g)
            for task in tasks:
                weight = references.weights[task.name]
                if task.tolerance is not None and weight > 0.0:
                    G, middle, _ = task_rows(task, seen, expected, references.tasks[task.name], len(expected.g))
                    near("G", level.G, weight**0.5 * G)
                    near("G x", level.upper + level.lower, 2.0 * weight**0.5 * middle)
        problem = layout.problem
        for name in ("A", "b", "C", "lower", "upper", "x_lower", "x_upper"):
            near(name, getattr(problem, name), getattr(expected, name))
        near("torque offset", layout.problem.offset, expected.torque_map[1])
