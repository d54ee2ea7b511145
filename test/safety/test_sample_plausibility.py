"""Rejection of unreachable samples, and the fault of consecutive rejections."""

import math

import numpy as np
import pytest

from wbc_controller.safety.sample_plausibility import SEQUENCE, SampleCheck

DT = 2_000_000  # ns


@pytest.fixture
def go2(robot_of):
    settings, model = robot_of("go2")
    return model, settings.safety


@pytest.fixture
def joints(go2):
    """Check with the nominal posture at rest as the last sample."""
    model, limits = go2
    check = SampleCheck.of_joints(model, limits, measured=True)
    accept(check, DT, model.posture, np.zeros(model.nj))
    return check, model


@pytest.fixture
def base(go2):
    check = SampleCheck.of_base(go2[1])
    accept(check, DT, pose(), np.zeros(6))
    return check


def accept(check, stamp, position, velocity):
    check.restart()
    assert check.check(stamp, position, velocity) == ""


def pose(x=0.0, angle=0.0):
    return np.array([x, 0.0, 0.4, 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)])


def test_a_sequence_is_a_fault_with_topic_number_and_reason(joints):
    check, model = joints
    for i in range(SEQUENCE):
        assert check.fault("/joint_states") is None
        check.check(DT * (2 + i), np.zeros(model.nj), np.zeros(model.nj))
    fault = check.fault("/joint_states")
    assert fault.code == "IMPLAUSIBLE_STATE"
    assert fault.sentence.startswith("/joint_states: 3 consecutive messages rejected: joint 'FL_thigh_joint' jumps")
    assert fault.sentence.endswith("(limit 0.2, safety.joint_mismatch)")
    assert check.check(DT * 60, np.zeros(model.nj), np.zeros(model.nj)) == ""  # restart after 0.1 s
    assert check.fault("/joint_states") is None


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"velocity": [0, 0, 0, 627.0, 0, 0]}, "base rotation about x has the velocity 627 rad/s (limit 50, safety."),
        ({"velocity": [0, 21.0, 0, 0, 0, 0]}, "base motion along y has the velocity 21 m/s (limit 20, safety.max"),
        ({"velocity": [1e200] * 6}, "base motion along x has the velocity 1e+200 m/s"),
        ({"velocity": [0, 0, 0, 0, 20.0, 0]}, "the velocity of base rotation about y changes from 0 to 20 rad/s"),
        ({"position": pose(x=0.5)}, "base motion along x jumps by 0.5 m within 2 ms, inconsistent with its velocity ("),
        ({"position": pose(angle=0.5)}, "base rotation about z jumps by 0.5 rad within 2 ms"),
        ({"position": pose(x=1e7)}, "base motion along x is at 1e+07 (limit 1e+06 rad or m, safety.max_magnitude)"),
        ({"position": np.zeros(7)}, "base motion along x jumps by nan m"),
    ],
)  # fmt: skip
def test_odometry_out_of_reach_is_rejected(base, values, reason):
    sample = {"position": pose(), "velocity": np.zeros(6), **values}
    said = base.check(2 * DT, np.array(sample["position"]), np.array(sample["velocity"], dtype=float))
    assert said.startswith(reason)


def test_fast_motions_and_impacts_are_within_reach(base, joints):
    check, model = joints
    v, q = np.zeros(model.nj), model.posture.copy()
    rng = np.random.default_rng(1)
    for i in range(2, 500):
        limits = model.velocity_limits
        new = np.clip(v + rng.uniform(-0.5, 0.5, model.nj) * limits, -limits, limits)
        q = q + 0.5e-9 * DT * (v + new)
        assert check.check(i * DT, q, new) == ""
        v = new
    assert base.check(2 * DT, pose(x=0.02, angle=0.02), np.array([4.0, 0, -4.0, 0, 10.0, 0])) == ""


def test_an_encoder_that_wraps_is_named(joints):
    check, model = joints
    q = model.posture.copy()
    q[0] += 2.0 * math.pi
    assert "the driver must unwrap encoders that wrap at ±π" in check.check(2 * DT, q, np.zeros(model.nj))


def test_without_measured_velocities_the_largest_ones_count(go2):
    model, limits = go2
    check = SampleCheck.of_joints(model, limits, measured=False)
    reach = limits.joint_mismatch + 5.0 * model.velocity_limits[0] * 1e-9 * DT
    for share, rejected in ((0.9, False), (1.1, True)):
        q = model.posture.copy()
        q[0] += share * reach
        accept(check, DT, model.posture, np.zeros(0))
        assert bool(check.check(2 * DT, q, np.zeros(0))) is rejected


def test_stamps_that_go_back_or_a_restart_begin_anew(joints):
    check, model = joints
    assert check.check(DT // 2, np.zeros(model.nj), np.zeros(model.nj)) == ""
    assert check.check(2 * DT, model.posture, np.zeros(model.nj)) != ""
    check.restart()
    assert check.check(2 * DT, model.posture, np.zeros(model.nj)) == ""
