"""Independence of the coordinates (S2): another base link, renumbered and flipped joints."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from demands import demand

from wbc_controller.controller.build.program import make_qp
from wbc_controller.inverse_dynamics.robot.actuation import Actuation
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.mechanics import CoordinateChange, change_coordinates
from wbc_controller.records import References, RobotState, frozen
from wbc_controller.validation.fuzz.problems import rest

NEW_ROOT = {"g1": "waist_pitch_joint", "go2": "RL_thigh_joint"}


def in_other_coordinates(model: RobotModel, other: CoordinateChange) -> tuple[RobotModel, np.ndarray]:
    """Return the model in other coordinates, and the sign of each joint of the command."""
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


def hurried(references: References, heading: float = 0.3) -> References:
    """Demand 8 m/s² of the centre of mass along a heading, beyond the friction."""
    return demand(references, "com", acceleration=8.0 * np.array([np.cos(heading), np.sin(heading), 0.0]))


@pytest.mark.parametrize("robot", list(NEW_ROOT))
def test_solution_is_independent_of_coordinates(robot_of, robot):
    settings, model = robot_of(robot)
    rng = np.random.default_rng(7)
    names = [name for name in model.pinocchio.names[1:] if name != "<floating base>"]
    flipped = [name for name in names if rng.random() < 0.5]
    other = change_coordinates(model.pinocchio, root=NEW_ROOT[robot], flip=flipped, shuffle=3)
    model_there, signs = in_other_coordinates(model, other)
    here, there = make_qp(settings, model), make_qp(settings, model_there)
    weights = {name: task.weight for name, task in settings.tasks.items()}  # of all tasks
    start = model.configuration(model.posture)
    worst, active = 0.0, 0
    for i in range(10):
        q = pin.integrate(model.pinocchio, start, 0.02 * rng.normal(size=model.nv))
        v = 0.1 * rng.normal(size=model.nv)
        states = RobotState(0, q, v), RobotState(0, other.configuration(q), other.velocity(q, v))
        answers = []
        for controller, state in zip((here, there), states, strict=True):
            references = dataclasses.replace(rest(controller, settings, state), weights=weights)
            answers.append(controller.solve(state, hurried(references) if i % 2 else references))
        a, b = answers
        assert a.relaxed == b.relaxed == ()
        active += any(name.startswith("cone:") for name in a.binding)
        forces = [np.concatenate(list(answer.forces.values())) for answer in answers]  # one foot may carry no load
        pairs = [(signs * a.tau, b.tau), (other.acceleration(q, v, a.v_dot), b.v_dot), (forces[0], forces[1])]
        for expected, found in pairs:
            worst = max(worst, float(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
    assert worst < 1e-8
    assert active >= 4


@pytest.mark.parametrize(("robot", "share"), [("go2", 0.92), ("g1", 1.0 - 1e-8)])
def test_available_friction_is_independent_of_heading(bench, robot, share):
    """Exactly for soles, with rotating pyramids; within cos(π / 8) for points."""
    standing, reached = bench(robot), []
    for heading in np.linspace(0.0, np.pi / 2.0, 9):
        q = standing.stance.copy()
        turn = pin.exp6(np.array([0.0, 0.0, 0.0, 0.0, 0.0, heading]))
        q[:7] = pin.SE3ToXYZQUAT(turn * pin.XYZQUATToSE3(q[:7]))
        state = standing.state(q)
        solution = standing.controller.solve(state, hurried(standing.references(state), heading))
        assert any(name.startswith("cone:") for name in solution.binding)
        ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
        reached.append(ahead @ standing.controller.dynamics.com_jacobian @ solution.v_dot)
    assert min(reached) > share * max(reached)
    if robot == "go2":  # 0.6 of gravity is 5.9 m/s², and the body sinks slightly
        assert min(reached) > 5.9
