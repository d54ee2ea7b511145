"""Effects and ends of actuator and world faults."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from stepping import has_faults

from wbc_controller.simulation.faults import actuators, world
from wbc_controller.simulation.faults.catalogue import kinds_of
from wbc_controller.simulation.mechanism import FLOOR
from wbc_controller.simulation.plant import Plant

ACTUATOR = "FL_calf_joint"
TAU = np.linspace(-20.0, 20.0, 12)


@pytest.fixture
def plant(go2):
    """Return a plant of its own for each test."""
    return Plant(*go2)


def torques(bench, kind, periods=1, **given):
    bench.plan(kind, duration=1.0, **given)
    found = []
    for number in range(periods):
        bench.faults.update()
        found.append(bench.faults.torques((1.0 + number) * TAU))
        bench.pass_period()
    return np.array(found)


def test_every_kind_has_a_test_here():
    text = Path(__file__).read_text(encoding="utf-8")
    for kind in (*kinds_of(actuators), *kinds_of(world)):
        assert f'"{kind.kind()}"' in text


@pytest.mark.parametrize(
    ("kind", "given", "factor"),
    [("actuator_dead", {}, 0.0), ("actuator_reversed", {}, -1.0), ("actuator_gain", {"factor": 0.5}, 0.5)],
)
def test_the_torque_of_one_actuator_is_scaled(bench, kind, given, factor):
    expected = TAU.copy()
    expected[bench.model.actuators.index(ACTUATOR)] *= factor
    assert torques(bench, kind, actuator=ACTUATOR, **given)[0] == pytest.approx(expected)


def test_an_actuator_that_is_not_named_is_drawn(bench):
    assert np.count_nonzero(torques(bench, "actuator_dead", seed=5)[0] != TAU) == 1


def test_saturation_bias_and_noise_are_shares_of_the_effort_limits(bench):
    at, limits = bench.model.actuators.index(ACTUATOR), bench.plant.effort_limits
    assert torques(bench, "actuator_weak", share=0.1)[0] == pytest.approx(np.clip(TAU, -0.1 * limits, 0.1 * limits))
    bench.faults.clear()
    added = torques(bench, "actuator_bias", actuator=ACTUATOR, share=-0.25)[0] - TAU
    assert added[at] == pytest.approx(-0.25 * limits[at])
    assert np.count_nonzero(added) == 1
    bench.faults.clear()
    noise = torques(bench, "actuator_noise", periods=300, share=0.02) - np.outer(np.arange(1, 301), TAU)
    assert np.std(noise / limits) == pytest.approx(0.02, rel=0.05)


def test_lagging_and_delayed_actuators(bench):
    keep = np.exp(-bench.period / 0.01)
    found = torques(bench, "actuator_lag", periods=3, time_constant=0.01)
    expected = [TAU, keep * TAU + (1.0 - keep) * 2.0 * TAU]
    expected.append(keep * expected[1] + (1.0 - keep) * 3.0 * TAU)
    assert found == pytest.approx(np.array(expected))
    bench.faults.clear()
    found = torques(bench, "actuator_delay", periods=5, delay=0.004)
    assert found == pytest.approx(np.array([TAU, TAU, TAU, 2.0 * TAU, 3.0 * TAU]))


@pytest.mark.parametrize(("kind", "given"), [("joint_locked", {}), ("joint_friction", {"share": 0.8})])
def test_a_joint_that_is_held_does_not_move_until_the_end(bench, kind, given):
    joint = bench.model.joints.index(ACTUATOR)
    tau = np.zeros(12)
    tau[joint] = -0.3 * bench.plant.effort_limits[joint]
    bench.plant.apply(tau)
    bench.plan(kind, joint=ACTUATOR, duration=0.02, **given)
    places = []
    for _ in range(20):
        bench.faults.update()
        places.append(bench.plant.state()[0][bench.model.q_index][joint])
        bench.pass_period()
    assert np.ptp(places[:10]) < 2e-3
    assert np.ptp(places[10:]) > 0.02


def changes_of_the_model(bench):
    model = bench.plant.model
    keys = (
        "body_mass", "body_inertia", "body_ipos", "geom_friction", "geom_solref", "geom_pos", "geom_quat",
        "geom_conaffinity", "geom_priority", "dof_frictionloss", "jnt_range", "jnt_limited", "eq_data",
        "dof_invweight0",
    )  # fmt: skip
    return {key: np.array(getattr(model, key)) for key in keys}


@pytest.mark.parametrize(
    ("kind", "given", "changed"),
    [
        ("payload", {"share": 0.2}, {"body_mass", "body_inertia", "dof_invweight0"}),
        ("mass_error", {"share": -0.2}, {"body_mass", "body_inertia", "dof_invweight0"}),
        ("center_of_mass_error", {"offset": 0.1}, {"body_ipos"}),
        ("slippery_floor", {"friction": 0.05}, {"geom_friction"}),
        ("slippery_floor", {"friction": 0.05, "contact": "front_left_foot"}, {"geom_friction", "geom_priority"}),
        ("soft_floor", {"time_constant": 0.1}, {"geom_solref"}),
        ("floor_hole", {"contact": "front_left_foot"}, {"geom_conaffinity"}),
        ("joint_friction", {}, {"dof_frictionloss"}),
        ("joint_locked", {}, {"jnt_range", "jnt_limited"}),
    ],
)
def test_the_model_is_changed_and_at_the_end_it_is_as_before(bench, kind, given, changed):
    before = changes_of_the_model(bench)
    bench.plan(kind, duration=0.004, **given)
    bench.faults.update()
    during = changes_of_the_model(bench)
    different = {key for key in before if not np.array_equal(before[key], during[key])}
    assert different - {"jnt_limited"} == changed - {"jnt_limited"}
    bench.run(2)
    bench.faults.update()
    after = changes_of_the_model(bench)
    assert {key for key in before if not np.allclose(before[key], after[key], rtol=1e-12)} == set()
    assert not has_faults(bench.faults)


def test_a_payload_weighs_what_it_says(bench):
    mass = bench.plant.model.body_mass.sum()
    bench.plan("payload", link="FL_calf", share=0.2, duration=1.0)
    bench.faults.update()
    added = bench.plant.model.body_mass.sum() - mass
    assert added == pytest.approx(0.2 * bench.model.mass)
    assert bench.plant.model.body_subtreemass[1] == pytest.approx(mass + added, rel=1e-6)


def test_the_centre_of_mass_of_the_base_is_off_in_the_physics(bench):
    base, model = bench.plant.body(bench.model.base_link), bench.plant.model
    # MuJoCo has a shortcut for a body with its centre of mass at its origin.
    model.body_ipos[base], model.body_iquat[base] = 0.0, [1.0, 0.0, 0.0, 0.0]
    model.body_sameframe[base] = mujoco.mjtSameFrame.mjSAMEFRAME_BODY
    bench.plant.forward()
    before = bench.plant.data.xipos[base].copy()
    bench.plan("center_of_mass_error", offset=0.1, duration=1.0)
    bench.faults.update()
    assert np.linalg.norm(bench.plant.data.xipos[base] - before) == pytest.approx(0.1)


def test_what_closes_loops_stays_where_it_is_when_masses_change():
    """MuJoCo would recompute the placement of connections."""
    link = '<body name="{}"><joint type="slide"/><geom size="0.1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{link.format('a')}{link.format('b')}</worldbody>"
        '<equality><connect body1="a" body2="b" anchor="0 0 0"/></equality></mujoco>'
    )
    model.eq_data[0, :6] = [0.1, 0.0, 0.0, 0.2, 0.0, 0.0]
    placed = model.eq_data.copy()
    world._set_constants(model)
    assert np.array_equal(model.eq_data, placed)


def test_a_sunk_floor_lets_the_robot_fall_onto_it(bench):
    bench.plant.hold(False, ramp=0.0)
    bench.plan("floor_drop", depth=0.2, duration=0.01)
    touch = bench.plant.contact_forces
    bench.run(150, damping=2.0)
    assert bench.plant.model.geom(FLOOR).pos[2] == pytest.approx(-0.2)
    assert touch.distance(bench.plant.data, touch.geoms["front_left_foot"]) == pytest.approx(0.0, abs=0.002)


def test_the_floor_tilts_by_its_angle_and_does_not_lift_the_robot(bench):
    bench.plan("floor_tilt", angle=0.2, ramp=0.1, duration=0.2)
    bench.run(110)
    normal = bench.plant.data.geom(FLOOR).xmat.reshape(3, 3)[:, 2]
    assert np.arccos(normal[2]) == pytest.approx(0.2)
    assert normal @ (bench.plant.state()[0][:3] * [1, 1, 0] - bench.plant.data.geom(FLOOR).xpos) == pytest.approx(
        0.0, abs=2e-3
    )


def test_a_foot_over_a_hole_has_no_contact_and_stays_free_until_it_is_above_the_floor(bench):
    foot = "front_left_foot"
    geoms = bench.plant.contact_forces.geoms[foot]
    bench.plant.hold(False, ramp=0.0)
    bench.plan("floor_hole", contact=foot, duration=0.3)
    bench.run(200, damping=0.5)
    assert not bench.plant.contact_wrenches()[foot].any()
    assert bench.plant.contact_forces.distance(bench.plant.data, geoms) < -0.001
    assert has_faults(bench.faults)
    assert not bench.plant.model.geom_conaffinity[geoms].any()


@pytest.mark.parametrize(
    ("kind", "given", "speed"), [("push", {"share": 0.1}, 0.01 * 9.81), ("kick", {"speed": 0.3}, 0.3)]
)
def test_a_push_has_its_impulse(bench, kind, given, speed):
    """In free flight the centre of mass gets the impulse per mass."""
    q, v = bench.plant.state()
    bench.plant.hold(False, ramp=0.0)
    q[2] += 5.0
    bench.plant.set_state(q, np.zeros_like(v))
    bench.plant.apply(np.zeros(12))
    bench.plan(kind, duration=0.1, **given)
    bench.run(60)
    mujoco.mj_subtreeVel(bench.plant.model, bench.plant.data)
    assert np.linalg.norm(bench.plant.data.subtree_linvel[1][:2]) == pytest.approx(speed, rel=0.02)
