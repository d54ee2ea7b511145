"""Energy and momentum balances between two states of a simulated robot, with correct and wrong models."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller import mechanics as wbm
from wbc_controller.records import RobotState
from wbc_controller.simulation.plant import Plant

#: Averaged steps: 0.1 s.
WINDOW = 100
PUSH = np.array([0.0, 25.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def squatting(robot_of):
    """Model and steps of Go2 squatting for two seconds, with a push in the last half second."""
    settings, model = robot_of("go2")
    plant = Plant(model, settings)
    plant.hold(False, 0.0)
    S = wbm.actuation_matrix(model.pinocchio, model.joints)
    steps = []

    def push_of(name, force):
        foot = settings.contacts[name]
        arm = plant.foot_placement(name).rotation @ foot.translation - [0.0, 0.0, foot.radius]
        return wbm.ExternalWrench(foot.frame, np.append(force, np.zeros(3)), "LOCAL_WORLD_ALIGNED", arm)

    for k in range(round(2.0 / (plant.step_seconds * plant.steps_per_period))):
        q, v = plant.state()
        wanted = model.posture + 0.25 * np.sin(3.0 * np.pi * plant.time) * np.tile([0.0, 1.0, -2.0], 4)
        plant.apply(100.0 * (wanted - q[model.q_index]) - 3.0 * v[model.v_index])
        if k == round(1.5 / (plant.step_seconds * plant.steps_per_period)):
            plant.push("base", PUSH, 1.0)
        for _ in range(plant.steps_per_period):
            before, force = RobotState(plant.stamp, *plant.state()), S.T @ plant.applied_torques
            plant.forward()
            wrenches = [push_of(*contact) for contact in plant.contact_wrenches().items()]
            plant.step()
            steps.append((before, RobotState(plant.stamp, *plant.state()), force, wrenches))
    return model.pinocchio, steps


def heavier(model, scale):
    """The same robot with a wrong mass of its base."""
    changed, inertia = model.copy(), model.inertias[1]
    changed.inertias[1] = pin.Inertia(scale * inertia.mass, inertia.lever, scale * inertia.inertia)
    return changed


def windows(values):
    """Means over windows of 0.1 s; (n, k)."""
    array = np.array(values)
    return array[: len(array) // WINDOW * WINDOW].reshape(-1, WINDOW, array.shape[1]).mean(axis=1)


def energy(model, steps, flip=None):
    """Residuals and throughput, with the torque of a joint reversed."""
    data, rows = model.createData(), []
    for before, after, force, wrenches in steps[400:1500]:
        applied = force if flip is None else np.where(np.arange(len(force)) == flip, -force, force)
        balance = wbm.energy_residual(model, before, after, applied, wrenches, data=data)
        rows.append((balance.residual, balance.throughput))
    return windows(rows)


def momentum(model, steps):
    data = model.createData()
    return windows([wbm.momentum_residual(model, b, a, wrenches, data=data).residual for b, a, _, wrenches in steps])


def test_energy_is_accounted_for_and_shows_a_wrong_mass_and_a_wrong_torque_sign(squatting):
    model, steps = squatting
    right = energy(model, steps)
    throughput = right[:, 1].mean()
    assert np.abs(right[:, 0]).max() < 0.02 * throughput
    calf = model.joints[model.getJointId("FL_calf_joint")].idx_v
    for wrong in (energy(heavier(model, 1.2), steps), energy(model, steps, flip=calf)):
        assert np.abs(wrong[:, 0]).max() > max(0.05 * throughput, 4.0 * np.abs(right[:, 0]).max())


def test_momentum_shows_a_wrong_mass_and_an_unknown_push(squatting):
    model, steps = squatting
    weight = pin.computeTotalMass(model) * 9.81
    assert np.abs(momentum(model, steps[400:1500])).max() < 0.005 * weight
    wrong_mass = momentum(heavier(model, 1.2), steps[400:1500])
    missing = 0.2 * model.inertias[1].mass * 9.81
    assert np.abs(wrong_mass[:, 2]).mean() == pytest.approx(missing, rel=0.2)  # the robot also accelerates
    pushed = momentum(model, steps[1600:])
    assert np.allclose(pushed[:, :3], PUSH[:3], atol=0.005 * weight)
