"""The controller's answer does not depend on the coordinates (S2): another base link, joints renumbered and flipped."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.references.changes import EnableTask
from wbc_controller.inverse_dynamics.robot.actuation import Actuation
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.mechanics import Recoordinated, recoordinate
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings.files import find_configuration, load_settings

NEW_ROOT = {"g1": "waist_pitch_joint", "talos": "arm_left_4_joint", "go2": "RL_thigh_joint"}


def in_other_coordinates(model: RobotModel, other: Recoordinated) -> tuple[RobotModel, np.ndarray]:
    """The robot's model on other coordinates, and the sign of each joint of the command."""
    joints = [other.model.joints[other.model.getJointId(name)] for name in model.joints]
    signs = np.array([other.signs[name] for name in model.joints])
    ends = np.sort(np.stack([signs * model.position_lower, signs * model.position_upper]), axis=0)
    v_index = np.array([joint.idx_v for joint in joints])
    return dataclasses.replace(
        model,
        pinocchio=other.model,
        q_index=np.array([joint.idx_q for joint in joints]),
        v_index=v_index,
        actuation=Actuation(model.actuation, v_index, model.actuation.C),
        position_lower=frozen(ends[0]),
        position_upper=frozen(ends[1]),
        posture=frozen(signs * model.posture),
    ), signs


@pytest.mark.parametrize("robot", list(NEW_ROOT))
def test_the_answer_is_the_same_in_other_coordinates(robot):
    settings = load_settings(find_configuration(robot))
    model = make_model(settings)
    rng = np.random.default_rng(7)
    names = [name for name in model.pinocchio.names[1:] if name != "<floating base>"]
    flipped = [name for name in names if rng.random() < 0.5]
    other = recoordinate(model.pinocchio, root=NEW_ROOT[robot], flip=flipped, shuffle=3)
    model_there, signs = in_other_coordinates(model, other)
    here, there = make_qp(settings, model), make_qp(settings, model_there)
    boards = [make_board(settings, controller) for controller in (here, there)]
    start = model.configuration(model.posture)
    worst = 0.0
    for _ in range(10):
        q = pin.integrate(model.pinocchio, start, 0.02 * rng.normal(size=model.nv))
        v = 0.1 * rng.normal(size=model.nv)
        q_there, v_there = other.configuration(q), other.velocity(q, v)
        answers = []
        for controller, board, state in zip((here, there), boards, ((q, v), (q_there, v_there)), strict=True):
            controller.dynamics.update(*state)
            board.reset(controller.dynamics, 0.0)
            board.apply([EnableTask(name, True) for name in settings.tasks], controller.dynamics, 0.0)
            answers.append(controller.solve(RobotState(0, frozen(state[0]), frozen(state[1])), board.sample(1.0)))
        a, b = answers
        assert a.relaxed == b.relaxed == ()
        forces = [np.concatenate(list(answer.forces.values())) for answer in answers]  # one foot may bear nothing
        pairs = [(signs * a.tau, b.tau), (other.acceleration(q, v, a.v_dot), b.v_dot), (forces[0], forces[1])]
        for expected, found in pairs:
            worst = max(worst, float(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
    print(f"{robot}: largest relative difference {worst:.1e}")
    assert worst < 1e-8
