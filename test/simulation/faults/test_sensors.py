"""Each sensor fault changes only its own measurements."""

import numpy as np
import pinocchio as pin
import pytest
from stepping import has_faults

from wbc_controller.simulation.faults import base_sensors, joint_sensors, messages
from wbc_controller.simulation.faults.catalogue import kinds_of
from wbc_controller.simulation.sensors import STREAMS

JOINT = "FL_calf_joint"
VALUES = (
    "position", "velocity", "effort", "pose", "twist", "orientation", "angular_velocity", "specific_force", "base",
    "silent", "absent",
)  # fmt: skip


def off_of(bench, found):
    """Return the errors of the positions of `JOINT`, (n,)."""
    joint = bench.model.joints.index(JOINT)
    return np.array([each.measured.position[joint] - each.true.position[joint] for each in found])


def changed(found) -> set[str]:
    """Return the names of measurements that differ from the truth."""
    names = set()
    for each in found:
        measured, true = each.measured, each.true
        names |= {name for name in VALUES if not np.array_equal(getattr(measured, name), getattr(true, name))}
        names |= {f"stamp of {stream}" for stream in STREAMS if measured.stamps[stream] != true.stamps[stream]}
    return names


def turn(found):
    """Return the rotation of the measured base relative to the true one, (3,) in rad."""
    true, measured = (pin.XYZQUATToSE3(values.pose).rotation for values in (found.true, found.measured))
    return pin.log3(true.T @ measured)


#: Measurements changed by each kind.
CHANGES = {
    kind: changed
    for kinds, changed in (
        ("joint_noise joint_scale joints_swapped", {"position", "velocity"}),
        (
            "joint_bias joint_quantization joint_lag joint_spike joint_jump joint_frozen joint_states_frozen "
            "joint_not_a_number",
            {"position"},
        ),
        ("joint_absurd velocity_sign velocity_dead", {"velocity"}),
        ("joint_missing", {"absent"}),
        ("velocity_lag", set()),  # the velocities of the bench are constant
        (
            "odom_noise odom_drift odom_turn_drift odom_jump odom_turn_jump odom_tilt odom_frozen odom_lag "
            "odom_bad_quaternion odom_absurd",
            {"pose"},
        ),
        ("odom_velocity_noise", {"twist"}),
        ("odom_slow", {"silent"}),
        ("odom_not_a_number", {"pose", "twist"}),
        ("odom_wrong_frame", {"base"}),
        ("imu_noise imu_shock", {"angular_velocity", "specific_force"}),
        ("imu_bias", {"angular_velocity"}),
        ("stamp_zero stamp_frozen stamp_back stamp_ahead stamp_drift", {"stamp of joint_states", "stamp of odom"}),
        ("clock_jump clock_frozen clock_drift", {"stamp of clock"}),
    )
    for kind in kinds.split()
}


def test_the_table_below_has_every_fault_of_a_sensor():
    kinds = [kind for room in (joint_sensors, base_sensors, messages) for kind in kinds_of(room)]
    assert set(CHANGES) == {kind.kind() for kind in kinds if not kind.place.startswith("delivery")}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_fault_changes_what_it_says_while_it_lasts_and_nothing_else(bench, kind):
    given = {"share": 0.3} if kind == "joint_spike" else {}
    bench.plan(kind, start=0.004, duration=0.02, seed=3, **given)
    assert changed(bench.measures(2)) == set()
    during = changed(bench.measures(10))
    assert during <= CHANGES[kind]
    assert bool(during) == bool(CHANGES[kind])
    assert changed(bench.measures(2)) == set()
    assert not has_faults(bench.faults)


def test_noise_has_its_standard_deviations(bench):
    bench.plan("joint_noise", sigma=0.01, velocity_sigma=0.2, duration=1.0)
    bench.plan("odom_noise", sigma=0.003, turn_sigma=0.002, duration=1.0)
    found = bench.measures(300)
    for quantity, sigma in (("position", 0.01), ("velocity", 0.2)):
        noise = [getattr(each.measured, quantity) - getattr(each.true, quantity) for each in found]
        assert np.std(noise) == pytest.approx(sigma, rel=0.05)
        assert abs(np.mean(noise)) < 0.1 * sigma
    assert np.std([each.measured.pose[:3] - each.true.pose[:3] for each in found]) == pytest.approx(0.003, rel=0.1)
    assert np.std([turn(each) for each in found]) == pytest.approx(0.002, rel=0.1)


def test_equal_seeds_give_equal_noise_and_others_other_noise(bench):
    def noise(seed):
        bench.faults.clear()
        bench.plan("joint_noise", duration=1.0, seed=seed)
        found = bench.measures(3)[-1]
        return found.measured.position - found.true.position

    assert noise(1) == pytest.approx(noise(1), abs=1e-12)
    assert noise(1) != pytest.approx(noise(2), abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "given", "offset"),
    [
        ("joint_bias", {"bias": 0.2, "ramp": 0.02}, lambda t, true: 0.2 * np.minimum(1.0, t / 0.02)),
        ("joint_bias", {"bias": -0.2, "ramp": 0.0}, lambda t, true: -0.2 + 0.0 * t),
        ("joint_scale", {"factor": 1.5}, lambda t, true: 0.5 * true),
        ("joint_frozen", {}, lambda t, true: true[0] - true),
        ("joint_quantization", {"step": 0.1}, lambda t, true: np.round(true / 0.1) * 0.1 - true),
    ],
)
def test_the_position_of_the_named_joint_is_off_as_it_says(bench, kind, given, offset):
    if kind != "joint_quantization":
        given = {**given, "joint": JOINT}
    bench.plan(kind, duration=1.0, **given)
    found, joint = bench.measures(20), bench.model.joints.index(JOINT)
    times, true = np.arange(20) * bench.period, np.array([each.true.position[joint] for each in found])
    assert off_of(bench, found) == pytest.approx(offset(times, true), abs=1e-12)


def test_a_jump_has_its_size_and_stays(bench):
    bench.plan("joint_jump", joint=JOINT, size=0.4, duration=1.0)
    bench.plan("odom_jump", size=0.7, duration=1.0)
    found = bench.measures(5)
    off = off_of(bench, found)
    assert np.abs(off) == pytest.approx(0.4)
    assert np.ptp(off) < 1e-9
    moved = np.array([each.measured.pose[:3] - each.true.pose[:3] for each in found])
    assert np.linalg.norm(moved, axis=1) == pytest.approx(0.7)
    assert np.ptp(moved, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert moved[:, 2] == pytest.approx(0.0)


def test_all_joint_states_repeat_bit_for_bit_while_stamps_go_on(bench):
    bench.plan("joint_states_frozen", duration=1.0)
    found = bench.measures(5)
    assert len({each.measured.position.tobytes() + each.measured.velocity.tobytes() for each in found}) == 1
    assert len({each.measured.stamps["joint_states"] for each in found}) == 5


def test_spikes_and_slow_odometry_come_at_their_rates(bench):
    bench.plan("joint_spike", joint=JOINT, size=2.0, share=0.1, duration=2.0)
    bench.plan("odom_slow", period=0.01, duration=1.0)
    found = bench.measures(500)
    assert 0.06 < (np.abs(off_of(bench, found)) > 1.0).mean() < 0.14
    assert np.flatnonzero(["odom" not in each.measured.silent for each in found[:20]]).tolist() == [0, 5, 10, 15]


def test_drifts_and_lags(bench):
    bench.plan("joint_lag", time_constant=0.01, duration=1.0)
    bench.plan("odom_lag", time_constant=0.01, duration=1.0)
    last = bench.measures(100)[-1]
    # A sampled filter of first order lags behind a ramp by dt k / (1 - k).
    keep = np.exp(-bench.period / 0.01)
    lag = bench.period * keep / (1.0 - keep)
    assert last.true.position - last.measured.position == pytest.approx(bench.true_speed * lag, rel=1e-3)
    assert last.true.pose[:2] - last.measured.pose[:2] == pytest.approx(np.array([0.3, 0.2]) * lag, rel=1e-3)
    bench.faults.clear()
    bench.plan("odom_drift", speed=0.5, duration=1.0)
    bench.plan("odom_turn_drift", rate=0.4, duration=1.0)
    last = bench.measures(26)[-1]
    assert np.linalg.norm(last.measured.pose[:3] - last.true.pose[:3]) == pytest.approx(0.5 * 25 * bench.period)
    assert np.linalg.norm(turn(last)) == pytest.approx(0.4 * 25 * bench.period)


def test_a_turned_base_is_turned_by_the_angle(bench):
    for kind, given, upright in (("odom_tilt", {"ramp": 0.0}, False), ("odom_turn_jump", {}, True)):
        bench.faults.clear()
        bench.plan(kind, angle=0.3, duration=1.0, **given)
        found = bench.measures(2)[-1]
        assert np.linalg.norm(turn(found)) == pytest.approx(0.3)
        assert (pin.XYZQUATToSE3(found.measured.pose).rotation[2, 2] == pytest.approx(1.0)) == upright


def test_values_that_are_none_and_missing_joints_are_what_they_say(bench):
    bench.plan("joint_not_a_number", joint=JOINT, duration=0.004)
    bench.plan("odom_not_a_number", duration=0.004)
    bench.plan("odom_bad_quaternion", start=0.004, length=0.5, duration=0.004)
    bench.plan("odom_absurd", start=0.004, value=1e150, duration=0.004)
    bench.plan("joint_absurd", start=0.004, joint=JOINT, value=1e100, quantity="position", duration=0.004)
    first, _, third, _ = bench.measures(4)
    assert np.isnan(first.measured.position).sum() == 1
    assert np.isnan([*first.measured.pose, *first.measured.twist]).sum() == 1
    assert np.linalg.norm(third.measured.pose[3:]) == pytest.approx(0.5)
    assert third.measured.pose[:3].max() == 1e150
    assert third.measured.position[bench.model.joints.index(JOINT)] == 1e100
    bench.faults.clear()
    bench.plan("joint_missing", joint=bench.model.joints[0], duration=1.0)
    bench.plan("joint_bias", joint=bench.model.joints[-1], bias=0.5, ramp=0.0, duration=1.0)
    found = bench.measures(1)[0]
    content = found.measured.message("joint_states")
    assert content.name == list(bench.model.joints[1:])
    assert content.position == pytest.approx([*found.true.position[1:-1], found.true.position[-1] + 0.5])
    assert len(content.velocity) == len(content.effort) == bench.model.nj - 1


def test_two_joints_have_each_others_values(bench):
    bench.plan("joints_swapped", joint=JOINT, duration=1.0)
    found = bench.measures(1)[0]
    (pair,) = [np.flatnonzero(found.measured.velocity != found.true.velocity)]
    assert len(pair) == 2
    assert bench.model.joints.index(JOINT) in pair
    assert found.measured.velocity[pair].tolist() == found.true.velocity[pair[::-1]].tolist()


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        ("stamp_zero", {}, lambda true: 0 * true),
        ("stamp_frozen", {}, lambda true: true[0] + 0 * true),
        ("stamp_back", {"by": 0.05}, lambda true: true - 50_000_000),
        ("stamp_ahead", {"by": 0.05}, lambda true: true + 50_000_000),
        ("stamp_drift", {"rate": -0.25}, lambda true: true[0] + 3 * (true - true[0]) // 4),
    ],
)
def test_stamps_are_off_as_they_say(bench, kind, given, expected):
    bench.plan(kind, stream="joint_states", duration=1.0, **given)
    found = bench.measures(5)
    true = np.array([each.true.stamps["joint_states"] for each in found])
    assert [each.measured.stamps["joint_states"] for each in found] == expected(true).tolist()
    assert all(each.measured.stamps["odom"] == each.true.stamps["odom"] for each in found)


def test_no_stamp_leaves_what_a_message_can_hold(bench):
    bench.plan("stamp_back", by=100.0, duration=1.0)
    bench.plan("clock_jump", by=-10.0, duration=1.0)
    found = bench.measures(1)[0].measured
    for stream in STREAMS:
        assert found.stamps[stream] >= 0
        found.message(stream)
