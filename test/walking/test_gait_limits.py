"""Kinematics of a leg, and the static limits of a gait."""

import math
import re

import numpy as np
import pinocchio as pin
import pytest
from gaits import simulated, walking

import wbc_controller as wbc
from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.controller.build.leg import swing_of
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.walking import find_feet, make_gait
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.walking.footsteps import Velocity

ROMEO = "package://example-robot-data/robots/romeo_description/"


def limits_of(settings):
    model = make_model(settings)
    return make_gait(settings, *find_feet(settings, model), make_qp(settings, model)), model


@pytest.fixture(scope="module")
def g1():
    return limits_of(wbc.load("g1").settings)


@pytest.mark.parametrize("offset", [(0.1, 0.0, 0.05, 0.0), (-0.1, 0.05, 0.02, 0.3)])
def test_a_leg_reaches_an_offset_with_a_flat_sole(g1, offset):
    limits, model = g1
    for each in limits.legs:
        posture, reason = each.leg.posture(np.array(offset), model.posture)
        assert reason == ""
        dynamics = Dynamics(model)
        before = each.foot.pose(dynamics)
        dynamics.update(model.configuration(posture), np.zeros(model.nv))
        after = each.foot.pose(dynamics)
        assert after.translation - before.translation == pytest.approx(offset[:3], abs=2.0e-3)
        assert pin.log3(after.rotation @ before.rotation.T) == pytest.approx([0.0, 0.0, offset[3]], abs=2.0e-3)
        assert not np.delete(posture - model.posture, each.leg.joints).any()


def test_out_of_reach(g1):
    limits, model = g1
    leg = limits.legs[0].leg
    assert leg.posture(np.array([0.0, 0.0, -0.3, 0.0]), model.posture)[1] == "length of the leg"
    assert leg.posture(np.array([0.0, 0.0, 0.3, 0.0]), model.posture)[1].startswith("position of left_")
    assert 0.1 < leg.lift(0.3) < 0.3


@pytest.mark.parametrize("velocity", [Velocity(0.3), Velocity(0.1j), Velocity(turning=0.4)])
def test_a_swing_is_the_nominal_step_relative_to_the_base(g1, velocity):
    """The rates are derivatives of the offsets; the length of the swing is two steps less the way of the base."""
    gait = g1[0].gait
    path = list(swing_of(velocity, 2.0 * gait.step_time, gait.single, gait.clearance, gait.lowering))
    offsets, rates = (np.array(part) for part in zip(*path, strict=True))
    way = 2.0 * gait.step_time - gait.single
    moved = [velocity.linear.real * way, velocity.linear.imag * way, 0.0, velocity.turning * way]
    assert offsets[-1] - offsets[0] == pytest.approx(moved, abs=1.0e-9)
    assert offsets[:, 2].max() == pytest.approx(gait.lowering + gait.clearance, rel=0.05)
    dt = gait.single / (len(path) - 1)
    middle = (offsets[1:] - offsets[:-1]) / dt
    assert middle == pytest.approx(0.5 * (rates[1:] + rates[:-1]), abs=0.12)


def test_the_joint_speeds_of_a_swing_are_those_of_a_walk(g1):
    """At 0.4 m/s, the fastest joint of a simulated walk is a knee; the steps of the walk adapt their time."""
    simulation = wbc.Simulation(wbc.load("g1").replace({"walking.max_speed": 0.4}))
    model = simulation.controller.model
    limits = limits_of(simulation.controller.config.settings)[0]
    fastest = np.zeros(model.nj)

    def note(now):
        np.maximum(fastest, np.abs(now.plant.state()[1][model.v_index]), out=fastest)

    simulation.controller.walk(0.4)
    simulation.run(3.2, note)
    share = fastest / (0.25 * model.velocity_limits)
    left = limits.legs[0]
    computed, cause = left.leg.swing_share(limits.swing(Velocity(0.4), left), 0.25 * model.velocity_limits)
    assert cause == "velocity of left_knee_joint"
    assert model.joints[int(np.argmax(share))].endswith("knee_joint")
    assert share.max() == pytest.approx(computed, rel=0.25)


@pytest.mark.parametrize(("way", "low", "high", "quantity"), [
    (Velocity(1.0), 0.45, 0.65, "knee_joint|friction"), (Velocity(turning=1.0), 1.0, 3.0, "friction"),
])  # fmt: skip
def test_feasible_speeds_of_g1(g1, way, low, high, quantity):
    found = g1[0].feasible(way, 3.0)
    assert low < found.speed < high
    assert re.search(quantity, found.quantity)


def test_loads_of_the_stance_leg(g1):
    """Torques and wrench balance weight and acceleration; turning loads the friction."""
    limits, _ = g1
    loads = limits.single_support()
    assert loads["left_foot"].share == pytest.approx(loads["right_foot"].share, rel=0.02)
    assert 0.2 < loads["left_foot"].share < 0.7
    weak = limits_of(wbc.load("g1").replace({"robot.effort_limit_scale": 0.2}).settings)[0].single_support()
    strong = [load for load in limits.support_loads(limits.legs[0], Velocity()) if load.text.startswith("torque")]
    assert weak["left_foot"].share == pytest.approx(5.0 * max(load.share for load in strong), rel=0.02)
    loads = [max(limits.support_loads(limits.legs[0], Velocity(turning=rate)), key=lambda load: load.share)
             for rate in (0.5, 1.0, 2.0)]  # fmt: skip
    shares = [load.share for load in loads]
    assert shares == sorted(shares)
    assert "friction" in loads[-1].text


def test_the_gait_of_romeo_keeps_its_ankles_in_range():
    """Its ankles permit a lift of 37 mm; with the lowering and clearance of other robots it falls."""
    draft = new_configuration(ROMEO + "urdf/romeo_small.urdf", srdf=ROMEO + "srdf/romeo_small.srdf")
    limits, _ = limits_of(draft.settings)
    gait, lift = limits.gait, limits.legs[0].leg.lift(0.1)
    assert lift == pytest.approx(0.037, abs=0.003)
    assert gait.lowering + gait.clearance == pytest.approx(0.8 * lift, rel=0.02)
    assert gait.lowering + gait.rough_clearance == pytest.approx(0.9 * lift, rel=0.02)
    simulation, _, walker = walking(draft.settings, 0.0, gait.speed[1], seconds=3.2)
    assert walker.steps >= 3
    assert simulation.plant.state()[0][1] > 0.12


@pytest.mark.parametrize(("quarters", "swapped"), [(0, False), (1, True), (-1, True), (2, False)])
def test_soles_with_other_axes(quarters, swapped):
    """Contacts may have any axes: the sole of the gait points forward."""
    sides, size = ("left_foot", "right_foot"), (0.025, 0.085) if swapped else (0.085, 0.025)
    changes = {f"contacts.{side}.rpy": [0.0, 0.0, 0.5 * math.pi * quarters] for side in sides}
    changes |= {f"contacts.{side}.half_length": size[0] for side in sides}
    changes |= {f"contacts.{side}.half_width": size[1] for side in sides}
    settings = wbc.load("g1").replace(changes).settings
    model = make_model(settings)
    for foot in find_feet(settings, model):
        assert foot.half == pytest.approx((0.085, 0.025))
        assert foot.sole(Dynamics(model)).heading == pytest.approx(0.0, abs=1.0e-12)


def test_a_quadruped_keeps_to_the_speeds_of_its_joints():
    """With the clearance and speed of Go2, whose joints may move faster, it falls."""
    settings = new_configuration("package://example-robot-data/robots/laikago_description/urdf/laikago.urdf").settings
    simulation, controller, walker = simulated(settings)
    gait = walker.gait
    assert 0.2 < gait.speed[0] < 0.6
    controller.walk(gait.speed[0])
    simulation.run(1.6)
    start, duration = simulation.plant.state()[0][0], 3.0 * gait.cycle
    simulation.run(duration)
    assert (simulation.plant.state()[0][0] - start) / duration == pytest.approx(gait.speed[0], abs=0.03)
