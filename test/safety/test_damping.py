"""Joint damping by a sampled controller: stable in every posture within the limits, with one more period of delay."""

import numpy as np
import pinocchio as pin
import pytest
from chains import MENAGERIE, menagerie
from urdf_models import build_model

from wbc_controller.controller.build.guard import make_guard_damping
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.inverse_dynamics.robot.transmission import Drive
from wbc_controller.safety.damping import damping_matrix, stable_damping

PERIOD = 0.002


def romeo():
    urdf = read_urdf("package://example-robot-data/robots/romeo_description/urdf/romeo_small.urdf")
    joints = list(pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer()).names)[2:]
    return build_model(urdf, joints, [0.0] * len(joints), floating_base=True)


def largest_rate(model, D, period, postures=400):
    """Largest eigenvalue of T W D at random postures within the limits, half of the joints at a limit in some."""
    rng, data = np.random.default_rng(1), model.pinocchio.createData()
    full = np.zeros(model.nv)
    full[model.v_index] = D
    rates = []
    for trial in range(postures):
        share = rng.random(model.nj)
        share = np.where(rng.random(model.nj) < 0.5 * (trial % 3), share.round(), share)
        q = model.configuration(model.position_lower + share * (model.position_upper - model.position_lower))
        M = np.triu(np.array(pin.crba(model.pinocchio, data, q)))
        M += np.triu(M, 1).T
        rates.append(period * np.linalg.eigvals(np.linalg.solve(M, np.diag(full))).real.max())
    return max(rates)


@pytest.mark.parametrize("name", ["g1", "go2", "talos", "romeo"])
@pytest.mark.parametrize(("damping", "period"), [(2.0, PERIOD), (100.0, PERIOD), (2.0, 0.01)])
def test_damping_is_stable_in_all_postures_with_one_more_period_of_delay(robot_of, name, damping, period):
    model = romeo() if name == "romeo" else robot_of(name)[1]
    D = stable_damping(model, damping, period)
    assert (D > 0.0).all()
    assert D.max() <= damping
    assert largest_rate(model, D, period) < 1.0


@pytest.mark.parametrize("name", ["g1", "go2", "talos"])
def test_controller_and_guard_damp_as_configured_as_far_as_that_is_stable(robot_of, name):
    settings, model = robot_of(name)
    damping, period = settings.safety.damping, 1.0 / settings.control.rate
    K = make_guard_damping(settings, model)
    guard = -model.actuation.at_joints(-K @ np.ones(model.nj))  # of each joint, as all have motors
    controller = stable_damping(model, damping, period)
    assert largest_rate(model, guard, period) < 0.5  # its joint states are up to one period older
    light = [joint for joint, D in zip(model.joints, controller, strict=True) if 0.8 * damping > D]
    assert all(joint.startswith("arm_") for joint in light)  # Talos's forearms
    assert bool(light) == (name == "talos")
    assert (guard <= controller).all()
    if name != "talos":
        np.testing.assert_allclose(guard, settings.guard.damping)


def test_rotors_behind_a_transmission_can_be_damped_too():
    transmission = menagerie().model_dump(exclude_unset=True)["robot"]["transmission"]
    D = {}
    for inertia in (0.0, 0.4):
        both = {**transmission["both"], "rotor_inertia": inertia}
        model = make_model(menagerie(transmission={**transmission, "both": both}), MENAGERIE)
        D[inertia] = dict(zip(model.joints, stable_damping(model, 1e4, PERIOD), strict=True))
    assert D[0.4]["hip"] > 1.4 * D[0.0]["hip"]


def test_actuators_that_drive_several_joints_take_energy():
    """With different damping of two joints that one actuator moves."""
    ratios = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    K = damping_matrix(Drive(["both", "one"], np.ones(2), ratios), np.array([0.1, 2.0, 1.0]))
    assert np.linalg.eigvalsh(ratios.T @ K).min() > -1e-12
    np.testing.assert_allclose(ratios.T @ K @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
