"""The mock robot's transmissions, springs, followers and locked joints against the controller's own model of them."""

import numpy as np
import pinocchio as pin
import pytest
from audits import audited
from chains import MENAGERIE, TENDON, menagerie
from snapshots import dynamics_at

import wbc_controller as wbc
from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.safety.model_audit import joint_efforts
from wbc_controller.simulation.plant import Plant


def forward(model, q, v, tau):
    """Equations of motion with the couplings, as one linear system in v̇ and λ."""
    dynamics, C = dynamics_at(model, q, v), model.actuation.C
    matrix = np.block([[dynamics.M, -C.T], [C, np.zeros((len(C), len(C)))]])
    right = np.concatenate([model.actuation.generalized_force(tau) - dynamics.h, np.zeros(len(C))])
    return np.linalg.solve(matrix, right)[: model.nv]


def made(**changes):
    """Settings, model and physics of the menagerie."""
    settings = menagerie(**changes)
    model = make_model(settings, MENAGERIE)
    return settings, model, Plant(model, settings)


def states(model, count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        base = (pin.SE3ToXYZQUAT(pin.SE3.Random()), rng.normal(size=6)) if model.floating_base else ()
        q, v = model.state(rng.uniform(-0.4, 0.4, model.nj), rng.normal(size=model.nj), *base)
        yield q, v, 0.5 * rng.uniform(-1.0, 1.0, model.na) * model.effort_limits


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize(
    ("follower", "changes"), [(False, {}), (True, {}), (True, TENDON)], ids=["stiff", "follower", "tendon"]
)
def test_it_accelerates_as_the_controllers_model_does(base, follower, changes):
    if not follower:  # the elbow is locked, and its wrist with it: nothing in MuJoCo's model is soft then
        changes = {
            "joints": ["hip", "shoulder", "knee", "ankle", "rail"], "posture": [0.2, 0.1, -0.3, 0.1, 0.05],
            "actuators": ["rail", "both", "shoulder", "knee_motor"],
            "locked_joints": {"tail": 0.7, "slide": -0.2, "elbow": 0.5},
        }  # fmt: skip
    _, model, plant = made(base=base, **changes)
    plant.hold(False, ramp=0.0)
    worst = 0.0
    for q, v, tau in states(model, 10):
        plant.set_state(q, v)
        plant.apply(tau)
        plant.forward()
        np.testing.assert_allclose(plant.state()[0], q, atol=1e-12)
        expected, found = forward(model, q, v, tau), plant.acceleration()
        worst = max(worst, float(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
    print(f"{base}, {'with' if follower else 'without'} a follower: largest relative difference {worst:.1e}")
    assert worst < (0.02 if follower else 1e-9)  # MuJoCo's coupling of a follower is soft


def test_actuators_saturate_and_followers_stay():
    _, model, plant = made()
    tau = np.zeros(model.na)
    tau[model.actuators.index("elbow")] = 6.0
    plant.apply(tau)
    elbow, follower = model.q_index[model.joints.index("elbow")], model.followers
    start, worst = plant.state()[0][elbow], 0.0
    for _ in range(300):
        plant.step()
        coupled = plant.state()[0][follower.q_index]
        worst = max(worst, abs(plant.data.joint(follower.names[0]).qpos - coupled).item())
    assert abs(plant.state()[0][elbow] - start) > 0.3
    assert 0.0 < worst < 2e-3
    _, model, plant = made()
    tau = np.zeros(model.na)
    tau[1] = 1000.0  # both: 70 N·m at most, twice that at the hip and at the knee
    plant.apply(tau)
    plant.forward()
    np.testing.assert_allclose(plant.data.qfrc_applied[plant._dof], [140.0, 0.0, 0.0, 140.0, 0.0, 0.0])


def test_a_rotor_between_two_branches_is_refused():
    settings = menagerie(
        transmission={"across": {"ratios": {"hip": 1.0, "shoulder": -1.0}, "effort_limit": 50.0, "rotor_inertia": 0.1}},
        actuators=["rail", "across", "shoulder", "knee", "elbow"],
    )
    model = make_model(settings, MENAGERIE)
    dynamics = Dynamics(model)
    hip, shoulder = (model.v_index[model.joints.index(name)] for name in ("hip", "shoulder"))
    for _ in range(3):  # no accumulation over cycles
        dynamics.update(model.configuration(model.posture), np.zeros(model.nv))
        assert dynamics.M[hip, shoulder] == pytest.approx(-0.1)
    with pytest.raises(
        ConfigurationError, match=r"robot.transmission.across.rotor_inertia = 0.1: it couples .* branch"
    ):
        Plant(model, settings)


def test_damping_never_drives_a_joint():
    _, model, plant = made()
    for q, v, _ in states(model, 10, seed=1):
        plant.set_state(q, v)
        plant.damp(2.0)
        at_joints = model.actuation.at_joints(plant.applied_torques)
        assert at_joints @ v[model.v_index] < 0.0
        passive = model.joints.index("ankle")
        np.testing.assert_allclose(at_joints[passive], 0.0)
        others = np.delete(np.arange(model.nj), passive)
        # R is square at the driven joints: equal damping.
        damping = -at_joints[others] / v[model.v_index][others]
        np.testing.assert_allclose(damping, damping[0])
        assert 0.0 < damping[0] <= 2.0


def test_the_audit_accounts_for_springs_transmissions_and_followers():
    """Controlled motion of 1 s: power and torques equal the model."""
    settings = menagerie()
    simulation = wbc.Simulation(wbc.load(settings, urdf=MENAGERIE))
    simulation.controller.set("posture", [-0.3, 0.5, -0.6, 0.4, -0.2])
    moving = [report for report in audited(simulation, 1.0) if report is not None and report.throughput > 1.0]
    efforts = joint_efforts(simulation.controller.model)
    energy = max(abs(report.energy) / report.throughput for report in moving)
    torque = max(np.max(np.abs(report.joint_torques) / efforts) for report in moving) / settings.audit.torque
    print(f"energy residual: {energy:.2%} of the power; torques {torque:.2f} of their limits")
    assert len(moving) > 200
    assert energy < 0.015
    assert torque < 0.5
    # Hip: 2 · 70; shoulder, elbow and rail: 60; knee: 2 · 70 + 3 · 50; the passive ankle: the median of them.
    np.testing.assert_allclose(efforts, [140.0, 60.0, 60.0, 290.0, 60.0, 60.0])
