"""The topic pose: its use, refusals, and effect on a robot under control."""

import numpy as np
import pytest
from imu_robot import IMU, THERE, Standing

from wbc_controller.middleware.codec import pose_with_covariance
from wbc_controller.records import Mode

POSES = {"estimation": IMU["estimation"] | {"absolute_pose": True}}


@pytest.fixture
def robot(bench):
    """Go2 with an IMU and absolute poses."""
    return Standing(bench("go2", POSES))


def base(robot):
    return robot.inputs.estimator.base[0]


def test_activation_requires_a_first_pose_only(robot):
    robot.cycle(80)
    assert robot.request("activate").mode is Mode.INACTIVE
    (refusal,) = robot.refused
    assert "base estimate has not arrived" in refusal
    assert "no absolute pose received (estimation.absolute_pose)" in refusal
    robot.cycle(600, pose=THERE)
    assert robot.request("activate").mode is Mode.ACTIVE
    np.testing.assert_allclose(base(robot), THERE, atol=1e-3)
    report = robot.cycle(100)
    assert report.mode is Mode.ACTIVE  # missing poses are no fault
    assert float(report.inputs.estimate["pose/age"].split()[0]) > 0.2
    before = base(robot).copy()
    off = THERE + [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    report = robot.cycle(600, pose=off)  # SLAM relocalized elsewhere
    assert report.mode is Mode.ACTIVE
    np.testing.assert_allclose(base(robot), before, atol=2e-3)
    said = [sentence for sentence in robot.refused if sentence.startswith("/pose: ")]
    assert len(said) == 2, said
    assert "rejected while the controller is active" in report.inputs.estimate["pose/contradiction"]
    statuses = [status for each in robot.bench.received("diagnostics") for status in each.status]
    assert any("rejected while the controller is active" in status.message for status in statuses)
    robot.bench.command("deactivate")
    robot.cycle(600, pose=off)
    np.testing.assert_allclose(base(robot), off, atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"frame": "odom"}, "header.frame_id is 'odom'; valid for an absolute pose: world, map"),
        ({"pose": THERE * np.nan}, "the pose is not finite"),
        ({"pose": [2e4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}, "the position is [20000.0, 0.0, 0.0] m (limit 10000 m from"),
        ({"pose": [0.0] * 7}, "the orientation"),
        ({"variance": np.inf}, "the covariance is not finite"),
        ({"variance": -1e-6}, "the covariance has the variances [-1e-06, "),
        ({"variance": 1e3}, "(limit 100 m² and rad² for position and heading)"),
        ({"covariance": np.ones(36) + np.diag([-0.5] * 6).ravel()}, "has the negative eigenvalue -0.5"),
        ({"time": 0}, "header.stamp is 0"),
        ({"time": 100_050_000_000}, "before the last message"),
    ],
)
def test_invalid_poses_are_refused_with_the_value(robot, changes, said):
    robot.cycle(60, pose=THERE)
    assert robot.refused == []
    robot.send_pose(**changes)
    robot.cycle()
    (sentence,) = robot.refused
    assert sentence.startswith("/pose: ")
    assert said in sentence


def test_a_message_that_is_too_large_is_refused(robot):
    robot.bench.send_bytes("pose", b"\x00" * (1 << 17))
    assert [": 1 messages dropped: more than 65536 bytes" in sentence for sentence in robot.cycle().refused] == [True]


def test_poses_are_subscribed_only_if_configured(bench):
    quiet = bench("go2", {"estimation": POSES["estimation"] | {"absolute_pose": False}})
    quiet.send("pose", pose_with_covariance(1, "odom", THERE, 0.0, 0.0))
    quiet.cycle()
    assert quiet.loop.estimator.poses is None
    assert not any("pose" in sentence for report in quiet.reports for sentence in report.refused)
