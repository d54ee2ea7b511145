"""The frame of references stays on the feet of a drifting filter, without jumps."""

import numpy as np
import pinocchio as pin

from wbc_controller.estimation.anchoring import Anchoring
from wbc_controller.inverse_dynamics.robot.orientation import about_z, heading_of
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

FEET = {
    "left": np.array([[0.1, 0.1, 0.0], [-0.1, 0.1, 0.0], [0.0, 0.15, 0.0]]),
    "right": np.array([[0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [0.0, -0.15, 0.0]]),
}
PERIOD = 0.02


def drifting(place, seconds, turn=0.02, speed=(0.01, -0.02, 0.005)):
    """Return a point of the true world in the world of a drifting filter."""
    return place @ about_z(turn * seconds).T + np.array([3.0, -5.0, 0.1]) + np.array(speed) * seconds


def reported(anchoring, positions):
    return positions @ anchoring.transform.rotation.T + np.array(anchoring.transform.translation)


def test_anchored_points_stay_while_the_filter_drifts():
    anchoring = Anchoring()
    for i in range(1000):
        now = i * PERIOD
        seen = {name: drifting(place, now) for name, place in FEET.items()}
        anchoring.update(now, seen)
        if i == 51:  # anchored after a second
            began = {name: reported(anchoring, place) for name, place in seen.items()}
    for name, place in seen.items():
        # lag of one time constant: 22 mm/s, and 0.02 rad/s at an arm of 0.15 m
        np.testing.assert_allclose(reported(anchoring, place), began[name], atol=0.006)
    assert abs(heading_of(anchoring.transform) + 0.02 * 19.0) < 0.01
    assert np.linalg.norm(drifting(FEET["left"], 19.98) - drifting(FEET["left"], 1.02)) > 0.4


def test_nothing_jumps_when_contacts_begin_end_and_slip():
    anchoring, rng = Anchoring(), np.random.default_rng(0)
    before, largest = None, 0.0
    for i in range(1500):
        now = i * PERIOD
        seen = {name: drifting(place, now) for name, place in FEET.items()}
        if 300 <= i < 400:
            anchoring.release("left")
            del seen["left"]
        if i >= 700:  # slipped by 5 cm and added again
            seen["right"] = seen["right"] + np.array([0.05, 0.0, 0.0])
            if i == 700:
                anchoring.release("right")
        if i >= 1000:  # undetected creep of 1 cm
            seen["left"] = seen["left"] + np.array([0.0, 0.01, 0.0])
        anchoring.update(now, {name: place + 1.0e-5 * rng.normal(size=place.shape) for name, place in seen.items()})
        base = reported(anchoring, drifting(np.array([[0.0, 0.0, 0.8]]), now))[0]
        if before is not None:
            largest = max(largest, float(np.linalg.norm(base - before)))
        before = base
    assert largest < 0.002  # in 20 ms: a tenth of half of the creep


def test_neither_a_single_point_nor_a_step_is_an_anchor():
    anchoring = Anchoring()
    for i in range(200):
        anchoring.update(i * PERIOD, {"foot": drifting(np.array([[0.1, 0.2, 0.0]]), i * PERIOD)})
    assert heading_of(anchoring.transform) == 0.0
    assert np.linalg.norm(anchoring.transform.translation) > 0.05
    anchoring = Anchoring()
    for i in range(400):
        foot = ("left", "right")[i // 40 % 2]  # 0.8 s each
        for other in set(FEET) - {foot}:
            anchoring.release(other)
        anchoring.update(i * PERIOD, {foot: drifting(FEET[foot], i * PERIOD)})
    assert anchoring.transform == pin.SE3.Identity()


def test_a_robot_whose_estimate_drifts_by_3_cm_a_second_keeps_its_feet():
    short = {"estimation.settling": 0.1, "safety.activation_ramp": 0.0}
    trial = EstimationTrial("go2", {"estimation.base_state": "imu", **short})
    trial.stand()
    trial.run(0.3)
    began, drift = trial.com(), np.array([0.0, 0.03, 0.0]) * trial.controller.period
    turn = about_z(0.02 * trial.controller.period)
    errors = []

    def check():
        found = trial.loop.estimator.filter
        found.rotation = turn @ found.rotation
        found.columns = turn @ found.columns
        found.columns[:, 1:] += drift[:, None]
        errors.append(np.linalg.norm(trial.com() - began))

    trial.run(1.2, check)
    assert np.linalg.norm(trial.loop.estimator.filter.position - trial.mock.plant.state()[0][:3]) > 0.03
    assert max(errors) < 0.012  # lag of 0.2 s at 30 mm/s
