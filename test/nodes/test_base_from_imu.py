"""The base state from the topic imu: the rules of odometry, and those of the estimate."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from imu_robot import GRAVITY, IMU, Standing
from refusals import refusal

from wbc_controller.controller.build.contacts import make_contact
from wbc_controller.controller.build.estimation import contact_normals, estimates_base, make_estimator
from wbc_controller.controller.build.program import make_qp
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.middleware.codec import wrench_stamped
from wbc_controller.records import Mode


@pytest.fixture
def robot(bench):
    """Go2 with an IMU, standing on its feet."""
    return Standing(bench("go2", IMU))


def test_activation_after_settling_and_standing_on_the_estimate(robot):
    robot.cycle(5)
    report = robot.request("activate")
    assert report.mode is Mode.INACTIVE
    (refusal,) = report.refused
    assert "'activate' is refused: base estimate has not arrived" in refusal
    assert "the robot has to stand still for 0.1 s" in refusal
    robot.bench.base(pose=[5.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])  # odometry is not used
    report = robot.activate()
    assert report.mode is Mode.ACTIVE
    assert report.refused == ()
    assert set(report.inputs.ages) == {"joint_states", "imu", "base estimate"}
    state = robot.inputs.latch().state
    np.testing.assert_allclose(state.q[:7], [0.0, 0.0, robot.bench.q[2], 0.0, 0.0, 0.0, 1.0], atol=2e-3)
    np.testing.assert_allclose(state.v, 0.0, atol=1e-6)
    report = robot.cycle(50)
    assert report.mode is Mode.ACTIVE
    weight = robot.bench.model.mass * 9.81
    assert sum(force[2] for force in report.solution.forces.values()) == pytest.approx(weight, rel=0.01)


def test_imu_data_that_end_are_a_fault_within_the_deadline(robot):
    robot.activate()
    assert robot.cycle(10, imu=False).mode is Mode.ACTIVE  # a gap of 20 ms is bridged
    assert robot.cycle().mode is Mode.ACTIVE
    cycles = 0
    while robot.bench.reports[-1].mode is Mode.ACTIVE:
        robot.cycle(imu=False)
        cycles += 1
    fault = robot.bench.reports[-1].fault
    assert (fault.code, cycles) == ("STALE_INPUT", 26)
    assert "imu is 52 ms old (limit 50 ms)" in fault.sentence


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"turning": (np.nan, 0.0, 0.0)}, "angular_velocity is not finite"),
        ({"turning": (0.0, 200.0, 0.0)}, "angular_velocity is [0.0, 200.0, 0.0] rad/s (limit 100)"),
        ({"force": (0.0, 0.0, -2e3)}, "linear_acceleration is [0.0, 0.0, -2000.0] m/s² (limit 1000)"),
        ({"frame": "head"}, "header.frame_id is 'head'; it must be the IMU's frame 'base'"),
        ({"time": 0}, "header.stamp is 0"),
    ],
)
def test_imu_data_that_cannot_be_used_are_refused_and_change_nothing(robot, changes, said):
    robot.activate()
    before = robot.inputs.latch().state
    assert [said in sentence for sentence in robot.cycle(**changes).refused] == [True]
    np.testing.assert_allclose(robot.inputs.latch().state.q, before.q, atol=1e-9)
    assert robot.cycle().mode is Mode.ACTIVE


def test_all_data_since_the_last_cycle_count(robot):
    """Four samples per period, with a short rotation in the second one."""
    robot.activate()
    bench, turned = robot.bench, []
    for fast in (False, True):
        before = robot.inputs.latch().state.q[5]
        start = bench.time
        bench.clock.time += bench.period
        for i in range(4):
            robot.imu(turning=(0.0, 0.0, 1.0 if fast and i == 1 else 0.0), time=start + (i + 1) * 500_000)
        bench.joints()
        bench.loop.cycle()
        turned.append(2.0 * (robot.inputs.latch().state.q[5] - before))
    assert turned[0] == pytest.approx(0.0, abs=1e-6)
    assert turned[1] == pytest.approx(0.0005, rel=0.2)  # 1 rad/s for half a millisecond


def test_a_slipping_foot_is_reported_and_its_friction_is_reduced_until_it_rests(robot):
    robot.activate()
    bench = robot.bench
    bench.q = bench.q.copy()
    bench.q[bench.model.q_index[bench.model.joints.index("RR_calf_joint")]] += 0.1  # the foot jumps
    assert [sentence for sentence in robot.cycle().refused if "the base estimate ignores" in sentence] == [
        "the base estimate ignores the slipping contact 'rear_right_foot' until it rests"
    ]
    reduced = robot.cycle(20).result.references.friction["rear_right_foot"]
    assert bench.loop.controller.board.slipping == ()
    assert reduced < robot.cycle(200).result.references.friction["rear_right_foot"] < 1.0


def test_a_contact_that_is_switched_off_does_not_hold_the_estimate(robot, make):
    robot.activate()
    robot.bench.send("contact_enable", make.bool(False), "front_left_foot")
    robot.cycle(110)
    assert holding(robot) == set(FEET[1:])


def test_an_imu_without_a_fixed_contact_or_frame_is_refused(robot_of, changed):
    settings, model = robot_of("go2")
    settings = changed(settings, IMU)
    sentence = refusal(make_estimator, settings, model, {})
    assert re.search("no contact is fixed to the world .*use estimation.base_state = 'odom'", sentence)
    fixed = SimpleNamespace(floating_base=False)
    assert "base estimation requires 'floating'" in refusal(make_estimator, settings, fixed, {})
    nose = changed(settings, {"estimation": {"imu_frame": "nose"}})
    assert "estimation.imu_frame = 'nose': the robot has no such frame" in refusal(make_estimator, nose, model, {})
    assert estimates_base(settings, model)
    assert not estimates_base(settings, fixed)
    assert not estimates_base(changed(settings, {"estimation": {"base_state": "odom"}}), model)


def test_a_restart_of_the_clock_ends_the_estimate(robot):
    robot.activate()
    robot.inputs.restart()
    latched = robot.inputs.latch()
    assert (latched.state, latched.ages["base estimate"]) == (None, np.inf)
    assert robot.cycle().fault.code == "STALE_INPUT"
    assert robot.cycle(10).fault is not None  # it must be at rest again
    assert robot.inputs.latch().state is None


def test_imu_data_without_joint_states_are_not_kept(robot):
    for _ in range(10):
        robot.bench.clock.time += robot.bench.period
        robot.imu()
        robot.bench.loop.cycle()
    assert robot.inputs._imu == []


def test_a_lost_estimate_restarts(robot):
    """No valid measurement was found that causes it, so the filter is corrupted directly."""
    robot.activate()
    robot.inputs.estimator._running.filter.P[:] = np.nan
    fault = robot.cycle().fault
    assert (fault.code, fault.sentence) == (
        "ESTIMATE_LOST",
        "the base estimate was lost: the state is not finite; the robot has to stand still for 0.1 s",
    )
    robot.cycle(80)
    robot.request("reset")
    assert robot.activate().mode is Mode.ACTIVE


@pytest.mark.parametrize(
    ("changes", "latest"),
    [
        ({"turning": (0.2, 0.0, 0.0)}, 0.7),
        ({"turning": (0.0, 0.2, 0.0)}, 0.9),
        ({"force": (0.0, 0.0, GRAVITY[2] + 20.0)}, 0.05),
        ({"force": (1.0, 0.0, GRAVITY[2])}, 0.3),
    ],
)
def test_an_imu_that_contradicts_all_contacts_is_a_fault_with_the_size(robot, changes, latest):
    robot.activate()
    report = robot.cycle(round(latest / robot.bench.period), **changes)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "ESTIMATE_LOST")
    found = re.fullmatch(
        r"the base estimate was lost: the IMU contradicts all contacts \((.*)\): the slowest of them moves at "
        r"(0\.\d\d) m/s \(limit 0\.1 m/s\); the IMU is wrong, or all contacts slip; "
        r"the robot has to stand still for 0\.1 s",
        report.fault.sentence,
    )
    assert set(found[1].split(", ")) == set(FEET)
    assert 0.1 <= float(found[2]) < 0.3


def test_a_gyroscope_bias_that_the_contacts_reveal_is_estimated(robot):
    robot.activate()
    for _ in range(1500):
        assert robot.cycle(turning=(0.0, 0.1, 0.0)).mode is Mode.ACTIVE
        assert np.abs(robot.bench.reports[-1].inputs.state.v[:3]).max() < 0.11
    np.testing.assert_allclose(robot.inputs.estimator.filter.gyroscope_bias, [0.0, 0.1, 0.0], atol=0.015)


def test_after_a_shock_on_the_hoist_the_estimate_starts_again_with_a_small_velocity(robot):
    """After 5 rad/s for 1.5 s the velocity had grown to 1,500 m/s on valid data."""
    robot.cycle(80)
    estimator = robot.inputs.estimator
    assert estimator.base is not None
    robot.cycle(round(1.5 / robot.bench.period), turning=(5.0, 0.0, 0.0))
    assert estimator.base is None
    assert estimator.waits_for.startswith("the base estimate was lost: the IMU contradicts all contacts")
    assert estimator.waits_for.endswith("the IMU turns at 5 rad/s (limit 0.5): the robot moves, or the gyroscope fails")
    (refusal,) = robot.request("activate", turning=(5.0, 0.0, 0.0)).refused
    assert refusal == f"command 'activate' is refused: {estimator.waits_for}"
    for _ in range(150):
        robot.cycle()
        assert estimator.base is None or np.abs(estimator.base[1]).max() < 1e-3
    assert robot.request("activate").mode is Mode.ACTIVE


def test_reset_restarts_the_settling(robot):
    robot.activate()
    robot.bench.command("reset")  # refused by an active controller
    assert robot.cycle().mode is Mode.ACTIVE
    robot.bench.command("damp")
    robot.cycle(10)
    estimator = robot.inputs.estimator
    assert estimator.base is not None
    robot.bench.command("reset")
    report = robot.request("activate")
    assert (report.mode, estimator.base) == (Mode.INACTIVE, None)
    (refusal,) = report.refused
    assert "'activate' is refused: base estimate has not arrived" in refusal
    assert robot.activate().mode is Mode.ACTIVE
    for word in ("damp", "reset"):  # in one cycle
        robot.bench.command(word)
    assert (robot.cycle().mode, estimator.base) == (Mode.INACTIVE, None)


FEET = ("front_left_foot", "front_right_foot", "rear_left_foot", "rear_right_foot")


def force(robot, newtons, foot=FEET[0], frame="", time=None):
    stamp = robot.bench.time if time is None else time
    robot.bench.send(
        "measured_wrench", wrench_stamped(np.array([0.0, 0.0, newtons, 0.0, 0.0, 0.0]), frame, stamp), foot
    )


def holding(robot):
    return {name.partition("/")[0] for name in robot.inputs.estimator.filter.names}


def test_a_fresh_force_sensor_decides_with_hysteresis(robot):
    robot.activate()
    weight = robot.bench.model.mass * 9.81
    held = []
    for share in (0.04, 0.06, 0.03, 0.02, 0.04, 0.06):  # on above 0.05, off below 0.025
        force(robot, share * weight)
        robot.cycle()
        held.append(FEET[0] in holding(robot))
        assert holding(robot) >= set(FEET[1:])
    assert held == [False, True, True, False, False, True]
    force(robot, 0.0)
    assert robot.cycle(49).refused == ()
    assert FEET[0] not in holding(robot)
    assert [sentence for _ in range(60) for sentence in robot.cycle().refused] == [
        "/wbc_controller/contacts/front_left_foot/measured_wrench: no force message for more than 0.1 s "
        "(estimation.contact_timeout); contact 'front_left_foot' is active as commanded"
    ]
    assert FEET[0] in holding(robot)
    force(robot, 0.0)
    robot.cycle()
    assert FEET[0] not in holding(robot)


def test_precedence_of_force_switch_and_command(robot, make):
    robot.activate()
    robot.bench.send("holds", make.bool(False), FEET[1])
    robot.cycle(100)  # a switch may publish changes only
    assert holding(robot) == {FEET[0], FEET[2], FEET[3]}
    force(robot, 100.0, FEET[1])
    robot.cycle()
    assert holding(robot) == set(FEET)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"newtons": np.nan}, "wrench.force is not finite"),
        ({"newtons": 2e5}, "wrench.force is [0.0, 0.0, 200000.0] N (limit 100000 N)"),
        ({"newtons": 50.0, "frame": "head"}, "is 'head'; valid for the force at contact 'front_left_foot'"),
        ({"newtons": 50.0, "time": 0}, "header.stamp is 0"),
    ],
)
def test_an_invalid_force_is_refused_without_effect(robot, changes, said):
    robot.activate()
    for _ in range(3):  # the third is read without the codec
        force(robot, 0.0)
        robot.cycle()
    force(robot, **changes)
    assert [said in sentence for sentence in robot.cycle().refused] == [True]
    assert FEET[0] not in holding(robot)
    robot.bench.send_bytes("measured_wrench", bytes(1 << 15), FEET[0])
    assert "more than 16384 bytes" in robot.cycle().refused[0]


def test_forces_before_a_restart_of_the_clock_are_ignored(robot):
    robot.activate()
    force(robot, 0.0)
    robot.cycle()
    robot.inputs.restart()
    assert (robot.inputs.latch(FEET).refused, set(robot.inputs.holding)) == ((), set(FEET))
    robot.bench.clock.time -= 0.5  # it starts again
    force(robot, 0.0)
    latched = robot.inputs.latch(FEET)
    assert (latched.refused, latched.touching) == ((), {FEET[0]: False})


def test_the_normal_is_known_in_the_frames_in_which_forces_are_measured(robot_of, changed):
    settings, model = robot_of("g1")
    contacts = make_qp(settings, model).contacts
    name, spec = next(iter(settings.contacts.items()))
    normals = contact_normals(model, {name: contacts[name]})[name]
    dynamics = Dynamics(model)
    normal = contacts[name].placement(dynamics).rotation[:, 2]
    for frame in (spec.frame, *set(normals) - {"", name}):
        turned = dynamics.placement(model.frame_id(frame, "")).rotation @ normals[frame]
        np.testing.assert_allclose(turned, normal, atol=1e-9)
    assert "world" not in normals
    go2, dog = robot_of("go2")
    slope = changed(go2, {"contacts": {FEET[0]: {"normal": [0.0, 1.0, 1.0]}}})
    found = contact_normals(dog, {FEET[0]: make_contact(FEET[0], slope.contacts[FEET[0]], dog)})[FEET[0]]
    assert set(found) == {"", FEET[0], "world"}
    np.testing.assert_allclose(found["world"], np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0))
    np.testing.assert_allclose(found[""], [0.0, 0.0, 1.0])
