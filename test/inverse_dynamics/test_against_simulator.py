"""Predictions of the quadratic program against MuJoCo, under the same torques.

States are sampled from a run under the controller: standing, swaying, squatting, both at once. Only states with firmly
standing feet are compared: contact speeds below 0.5 mm/s, and load on every corner. The simulated floor is slightly
elastic, unlike rigid contacts.

Errors are relative to the norm of the compared quantity, at least 9.81 m/s² for v̇ and the robot's weight for forces.
"""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import simulate

from wbc_controller.controller.build.references import make_board
from wbc_controller.inverse_dynamics.references.changes import SetTrajectory
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.records import RobotState, frozen
from wbc_controller.simulation.plant import Plant

ACCELERATION, FORCE = 0.02, 0.005
#: Centre of mass references, m, for 0.7 s each: sway, sway and squat, squat further, return.
JOURNEY = ((0.2, (0.0, 0.02, 0.0)), (0.9, (0.0, -0.02, -0.03)), (1.9, (0.01, 0.0, -0.05)), (2.6, (0.0, 0.0, 0.0)))
#: Soles of the controller, smaller than the real ones: a foot rocks on its edge.
SOLES = {"g1": {"half_width": 0.02}}
#: Largest contact speed of a standing foot: norm over all contacts, m/s and rad/s together.
SPEED = 5.0e-4
#: Smallest force on a loaded corner, N.
LOAD = 2.0
#: Cycles of the initial penetration of the floor.
SETTLED = 50


def whole_feet_bear(plant):
    """Return True if every sphere of the feet, also at the corners of soles, carries load."""
    borne, force = {}, np.zeros(6)
    for index in range(plant.data.ncon):
        mujoco.mj_contactForce(plant.model, plant.data, index, force)
        borne |= dict.fromkeys((int(geom) for geom in plant.data.contact[index].geom), force[0])
    feet = [geom for geoms in plant.contact_forces.geoms.values() for geom in geoms]
    balls = [geom for geom in feet if plant.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE]
    return all(borne.get(geom, 0.0) > LOAD for geom in balls)


def let_go(robot):
    """Return the simulation of a standing robot without its hoist, and a board with resting references."""
    plant, dynamics = Plant(robot.model, robot.settings), robot.controller.dynamics
    plant.hold(False, ramp=0.0)
    board = make_board(robot.settings, robot.controller)
    dynamics.update(*plant.state())
    board.reset(dynamics, 0.0)
    return plant, board


@pytest.mark.parametrize("name", ["g1", "go2"])
def test_accelerations_and_contact_forces_equal_the_simulator(bench, name):
    """In a run of 3.4 s, compared every 20 ms."""
    robot = bench(name).on_soles(**SOLES.get(name, {}))
    model, controller = robot.model, robot.controller
    plant, board = let_go(robot)
    start, tau, journey = np.array(controller.dynamics.com), None, list(JOURNEY)
    moved, errors, speeds, weight = 0.0, [], [], model.mass * model.gravity
    for cycle in range(1700):
        time = cycle * controller.formulation.period
        if journey and time >= journey[0][0]:
            knot = Knot(0.7, start + journey.pop(0)[1], np.zeros(3), np.zeros(3))
            board.apply([SetTrajectory("com", None, (knot,))], controller.dynamics, time)
        q, v = plant.state()
        solution = controller.solve(RobotState(plant.stamp, frozen(q), frozen(v)), board.sample(time), tau)
        assert not solution.relaxed
        tau = solution.tau
        plant.apply(tau)
        if cycle >= SETTLED and cycle % 10 == 0:
            plant.forward()
            moved = max(moved, float(np.linalg.norm(controller.dynamics.com - start)))
            contacts = controller.contacts.values()
            speed = np.concatenate([contact.jacobian(controller.dynamics) @ v for contact in contacts])
            if np.linalg.norm(speed) < SPEED and whole_feet_bear(plant):
                acceleration, wrenches = plant.acceleration(), plant.contact_wrenches()
                expected = np.concatenate([solution.forces[name] for name in wrenches])
                force = np.concatenate(list(wrenches.values()))
                off = np.linalg.norm(solution.v_dot - acceleration), np.linalg.norm(expected - force)
                errors.append(off / np.maximum([np.linalg.norm(acceleration), np.linalg.norm(force)], [9.81, weight]))
                speeds.append(float(np.linalg.norm(v)))
        simulate(plant, plant.steps_per_period)
    assert not plant.fallen
    assert moved > 0.04
    assert len(speeds) >= 20
    assert sum(speed > 0.1 for speed in speeds) >= 20
    assert max(speeds) > 0.3
    assert (np.max(errors, axis=0) < [ACCELERATION, FORCE]).all()


def test_unreachable_squat_keeps_joint_limits(bench):
    """Talos, commanded to squat further than its knees bend, and faster than they can brake."""
    robot = bench("talos")
    model, controller = robot.model, robot.controller
    plant, board = let_go(robot)
    plant.model.jnt_limited[:] = 0  # only torques stop a joint
    knot = Knot(0.3, controller.dynamics.com - [0.0, 0.0, 0.5], np.zeros(3), np.zeros(3))
    board.apply([SetTrajectory("com", None, (knot,))], controller.dynamics, 0.0)
    step = robot.settings.limits.torque_rate * controller.formulation.period * model.effort_limits
    tau, beyond, relaxed = None, [], 0
    for cycle in range(700):
        q, v = plant.state()
        references = board.sample(cycle * controller.formulation.period)
        solution = controller.solve(RobotState(plant.stamp, frozen(q), frozen(v)), references, tau)
        # As the supervisor sends them: the torque rate always holds.
        tau = solution.tau if tau is None else np.clip(solution.tau, tau - step, tau + step)
        relaxed += bool(solution.relaxed)
        plant.apply(tau)
        simulate(plant, plant.steps_per_period)
        joints = plant.state()[0][model.q_index]
        beyond.append(np.maximum(joints - model.position_upper, model.position_lower - joints).max())
    assert 10 < relaxed < 150
    assert max(beyond) < 0.02
    up = Rotation.from_quat(plant.state()[0][3:7]).as_matrix()[2, 2]
    assert up > np.cos(0.3)
