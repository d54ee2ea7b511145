"""Sensors of the base against the legs: detection of axis and unit errors."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.estimation import make_leg_kinematics
from wbc_controller.controller.controller import Controller
from wbc_controller.estimation.axes_comparison import AxesComparison
from wbc_controller.estimation.sensor_agreement import PERIOD, OdometryAgreement, SensorAgreement, gravity_contradiction

QUARTER = pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2.0)


def motion(time):
    """Return a rotation in rad and a displacement in m along all axes, (2, 3)."""
    rates = np.array([[5.0, 8.0, 12.0], [6.0, 11.0, 15.0]])
    return np.array([[0.03, 0.02, 0.015], [0.01, 0.03, 0.02]]) * np.sin(time * rates)


def compared(C, *, world=None, noise=3.0e-4, lever=0.0):
    """Return the last message about a and C a, (3, 3) or by kind, the time of the first, s, and the comparison."""
    comparison, rng, first = AxesComparison(with_displacements=True), np.random.default_rng(0), None
    for time in np.arange(PERIOD, 2.0, PERIOD):
        a = motion(time)
        b = (C @ a[..., None])[..., 0] + noise * rng.normal(size=(2, 3))
        said = comparison.update(PERIOD, a, b, world, lever=lever)
        first = time if first is None and said is not None else first
    return said, first, comparison


@pytest.mark.parametrize("lever", [0.0, 0.7])
@pytest.mark.parametrize(
    ("C", "said"),
    [
        (np.stack([np.degrees(1.0) * np.eye(3), np.eye(3)]), "as if angular velocities were in deg/s instead of rad/s"),
        (QUARTER, "as if the axes were rotated by -90° about z or the axes x, y, z were -y, x, z"),
        (pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 4.0), "as if the axes were rotated by -45° about z"),
        (pin.rpy.rpyToMatrix(0.0, np.radians(22.0), 0.0), "as if the axes were rotated by -22° about y"),
        (np.diag([1.0, -1.0, -1.0]), "180° about x or the axes x, y, z were x, -y, -z"),
        (-np.eye(3), "as if the axes x, y, z were -x, -y, -z"),
        (np.eye(3)[[1, 0, 2]], "as if the axes x, y, z were y, x, z"),
        (np.diag([1.0, 1.0, -1.0]), "as if the axes x, y, z were x, y, -z"),
    ],
)
def test_errors_of_axes_and_units_are_named(C, said, lever):
    found, first, comparison = compared(C, lever=lever)
    assert said in found
    assert first < 0.2
    assert not comparison.agreed


def test_tipping_soles_do_not_look_like_inverted_axes():
    """A push tips both soles by φ about their edge at the height -h, and the base by θ: the legs see θ - φ."""
    said = {}
    for lever in (0.0, 0.9):
        comparison, said[lever] = AxesComparison(with_displacements=True), []
        for time in np.arange(PERIOD, 0.2, PERIOD):
            theta, phi, moved, h = 0.05 * time, 0.12 * time, 0.05 * time, 0.9
            turns, moves = np.zeros((2, 3)), np.zeros((2, 3))
            turns[:, 1], moves[:, 0] = (theta - phi, theta), ((theta - phi) * h + moved, theta * h + moved)
            said[lever].append(comparison.update(PERIOD, *np.stack([turns, moves], axis=1), None, lever=lever))
    assert "as if the axes were rotated by" in said[0.0][-1]
    assert said[0.9] == [None] * len(said[0.9])


def test_a_twisting_sole_does_not_look_like_rotated_axes():
    """In a fast step after a push, a sole of G1 twisted by 0.7° on the ground."""
    legs, gyroscope = np.array([[-0.0533, -0.145, 0.00885]]), np.array([[-0.0554, -0.145, -0.00264]])
    assert AxesComparison(with_displacements=False).update(0.1, legs, gyroscope, None) is None


def test_a_twist_in_the_axes_of_the_world_is_named():
    said = "as if the twist were in the axes of the world, not of child_frame_id"
    assert said in compared(QUARTER, world=QUARTER)[0]
    assert said not in compared(QUARTER, world=QUARTER.T)[0]


@pytest.mark.parametrize("C", [np.eye(3), np.zeros((3, 3)), 0.5 * np.eye(3), np.diag([1.0, 0.0, 1.0])])
def test_agreement_and_contradictions_with_other_causes_are_not_reported(C):
    """Hoist, soft ground, and a foot slipping about one axis."""
    _, first, comparison = compared(C)
    assert first is None
    assert comparison.agreed == np.array_equal(C, np.eye(3))


def test_agreement_about_one_axis_is_not_final():
    comparison = AxesComparison(with_displacements=False)
    for time in np.arange(0.0, 2.0, PERIOD):
        a = np.array([[0.05 * np.sin(6.0 * time), 0.0, 0.0]])
        assert comparison.update(PERIOD, a, a, None) is None
    assert comparison.turns_agree
    assert not comparison.agreed


@cache
def standing(robot):
    """Return the legs of a standing robot from its base, its model, and its contacts: soles of G1, balls of Go2."""
    controller = Controller(robot, preflight=False)
    settings, model = controller.config.settings, controller.model
    contacts = {name: controller.contacts[name] for name in settings.contacts}
    kinematics = make_leg_kinematics(settings, model, contacts, model.base_link)
    kinematics.update(np.array(model.posture), np.zeros(model.nj))
    return kinematics, model, tuple(name for name in contacts if name in kinematics.points)


@pytest.mark.parametrize("robot", ["g1", "go2"])
@pytest.mark.parametrize(
    ("roll", "said"),
    [(0.0, None), (0.5, None), (-0.9, None), (np.pi / 2.0, "90° apart: as if rotated about its x axis"),
     (np.pi, "180° apart: wrong sign, or z axis pointing down")],
)  # fmt: skip
def test_gravity_is_compared_with_the_contacts(robot, roll, said):
    kinematics, _, contacts = standing(robot)
    found = gravity_contradiction(kinematics, contacts, np.array([0.0, np.sin(roll), np.cos(roll)]))
    assert found is None if said is None else said in found
    assert gravity_contradiction(kinematics, (), np.array([0.0, 0.0, -1.0])) is None


@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_turn_and_displacement_are_those_of_the_legs(robot, monkeypatch):
    """The robot bends its legs with its feet at rest; the sensor measures in deg/s."""
    kinematics, _, contacts = standing(robot)
    sensor = SensorAgreement(kinematics, "the sensor", with_displacements=True)
    still, before = kinematics.positions(contacts), np.zeros((2, 3))
    sensor.check(PERIOD, before, contacts)
    said = None
    for time in np.arange(PERIOD, 0.5, PERIOD):
        turn, way = motion(time)
        positions = (still - way) @ pin.exp3(turn)
        monkeypatch.setattr(kinematics, "positions", lambda _, positions=positions: positions)
        steps, before = motion(time) - before, motion(time)
        said = said or sensor.check(PERIOD, steps * [[np.degrees(1.0)], [1.0]], contacts)
    assert f"the sensor contradicts the legs ({', '.join(contacts)}): a turn of" in said
    assert "in deg/s instead of rad/s" in said
    # A foot that a wrong sensor has shaken off does not hide the reason.
    assert sensor.check(PERIOD, before, contacts[:1]) is None
    assert "in deg/s" in (sensor.check(PERIOD, before, contacts, known_wrong=True) or "")


def test_no_comparison_without_rigid_motion(monkeypatch):
    kinematics, _, contacts = standing("g1")
    sensor, still = SensorAgreement(kinematics, "the sensor", with_displacements=True), kinematics.positions(contacts)
    for time in np.arange(0.0, 1.0, PERIOD):
        slip = np.where(np.arange(len(still))[:, None] < 3, motion(time)[1], 0.0)
        monkeypatch.setattr(kinematics, "positions", lambda _, slip=slip: still + slip)
        assert sensor.check(PERIOD, -5.0 * motion(time), contacts) is None


def test_no_comparison_directly_after_a_touchdown(monkeypatch):
    """In a trot, the landed feet of Go2 roll for 0.04 s, and the legs then measure the opposite turn of the body."""
    kinematics, _, contacts = standing("go2")
    sensor, still = SensorAgreement(kinematics, "the sensor", with_displacements=False), kinematics.positions(contacts)
    turn = np.array([0.0, 0.0, 0.005])

    def check(step, landed):
        positions = (still @ pin.exp3(step * turn))[: len(landed)]
        monkeypatch.setattr(kinematics, "positions", lambda _: positions)
        return sensor.check(PERIOD, -turn[None], landed)

    assert not any(check(step, contacts if step % 5 < 3 else contacts[:2]) for step in range(100))
    assert any("as if" in (check(step, contacts) or "") for step in range(100, 150))


def test_odometry_with_a_wrong_twist_remains_refused_until_a_restart():
    kinematics, model, contacts = standing("go2")
    agreement, joints = OdometryAgreement(kinematics), (np.array(model.posture), np.zeros(model.nj))
    pose, before = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    for i in range(200):
        turn = motion(0.002 * i)[0]
        pose[3:], rate = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(turn), np.zeros(3)))[3:], (turn - before) / 0.002
        before = turn
        twist = np.concatenate([np.zeros(3), np.degrees(rate)])
        agreement.update(0.002 * i, (pose.copy(), twist), joints, contacts, controlled=True)
    assert "the twist of odometry contradicts its pose: a turn of" in agreement.contradiction
    assert "deg/s" in agreement.contradiction
    agreement.restart()
    assert agreement.contradiction is None
