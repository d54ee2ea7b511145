"""Values and references of tasks as messages."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.inverse_dynamics.tasks import AccelerationTask
from wbc_controller.middleware.codec import encode
from wbc_controller.middleware.setpoints import setpoint_message
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.nodes.diagnostics.task_reports import TaskStates
from wbc_controller.nodes.wiring import make_vocabulary


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
    states = TaskStates(qp.tasks, words)
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
            made = partial(
                setpoint_message, TASK_TYPES[kind]["setpoint"], kind, frame=frame, stamp=stamp, joints=joints
            )
            expected[name] = {key: encode(made(position)) for key, position in positions.items()}
        states.begin(words.kinds)
        said = iter(lambda: states.next(stamp, dynamics, references), None)  # noqa: B023
        assert dict(said) == expected
        states.begin(("feet", "nothing"))
        assert states.next(stamp, dynamics, references) == ("feet", expected["feet"])
        assert states.next(stamp, dynamics, references) is None
