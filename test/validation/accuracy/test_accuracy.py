"""Commands of `wbc accuracy`: results of short runs, and their statistics."""

from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.errors import NoSolution
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.fault import LONGEST
from wbc_controller.simulation.faults.world import SlipperyFloor
from wbc_controller.simulation.sensors import PARTS
from wbc_controller.validation.accuracy import walks
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.validation.accuracy.flaws import FLAWS, FlawErrors, chatter, measure_flaw
from wbc_controller.validation.accuracy.mishaps import Outcome, longest_run, run_mishap
from wbc_controller.validation.accuracy.standing import StandingErrors, consistency, error_of, sensor_settings, stand
from wbc_controller.validation.accuracy.walks import mean_velocity, walk

#: Changes of the settings that shorten a start.
SHORT = {"estimation.settling": 0.1, "safety.activation_ramp": 0.0}


def test_errors_of_standing_robots_agree_with_the_truth():
    """Talos is tall with light ankles, and has cheap sensors."""
    found = stand("go2", "good", 0, 0.5)
    assert (found.ended, len(found.observable_nees), len(found.drifting_nees)) == ("", 5, 4)
    assert 0.0 < found.tilt < np.deg2rad(0.4)
    assert found.height < 0.003
    assert 0.0 < found.velocity < 0.02
    assert (found.observable_nees > 0.0).all()
    found = stand("talos", "cheap", 7, 0.3)
    assert found.ended == ""
    assert found.velocity < 0.005


def test_ideal_sensors_and_a_wrong_estimate():
    trial = EstimationTrial("go2", {"estimation.base_state": "imu", **SHORT})
    trial.stand()
    error, P = error_of(trial)
    assert np.abs(error[:6]).max() < 2e-3
    assert (np.diag(P) > 0.0).all()
    filter = trial.loop.estimator.filter
    filter.columns[:, 0] += [0.1, 0.0, 0.0]
    filter.columns[:, 1] += [0.0, 0.2, 0.0]
    np.testing.assert_allclose(error_of(trial)[0] - error, [0, 0, 0, 0.1, 0, 0, 0, 0.2, 0], atol=1e-9)


def test_errors_and_nees_by_component(monkeypatch):
    still = SimpleNamespace(
        settings=SimpleNamespace(control=SimpleNamespace(rate=10.0)),
        stand=lambda: None,
        run=lambda seconds, look: [look() for _ in range(4)],
    )
    error, P = np.arange(1.0, 10.0), np.eye(9)
    looks = iter([(error, P), (2.0 * error, P), (2.0 * error, 2.0 * P), (3.0 * error, 5.0 * P)])
    monkeypatch.setattr("wbc_controller.validation.accuracy.standing.EstimationTrial", lambda *_: still)
    monkeypatch.setattr("wbc_controller.validation.accuracy.standing.error_of", lambda trial: next(looks))
    found = stand("go2", "good", 3, 1.0)
    factor = np.sqrt((1.0 + 4.0 + 4.0 + 9.0) / 4.0)
    assert found.tilt == pytest.approx(factor * np.hypot(1.0, 2.0))
    assert found.velocity == pytest.approx(factor * np.linalg.norm([4.0, 5.0, 6.0]))
    assert found.height == pytest.approx(9.0 * np.sqrt((0.0 + 1.0 + 1.0 + 4.0) / 4.0))
    assert found.drift == pytest.approx(2.0 * np.hypot(7.0, 8.0) / (0.3 / 60.0))
    tilt_and_velocity, heading_and_position = 1 + 4 + 16 + 25 + 36, 9 + 49 + 64 + 81
    np.testing.assert_allclose(found.observable_nees, tilt_and_velocity * np.array([1.0, 4.0, 4.0 / 2.0, 9.0 / 5.0]))
    np.testing.assert_allclose(found.drifting_nees[1:], heading_and_position * np.array([1.0, 4.0 / 4.0]))


def test_filter_settings_of_the_sensors():
    settings = load("go2").replace(sensor_settings("cheap")).settings.estimation
    assert settings.accelerometer_bias == PARTS["cheap"].accelerometer_bias
    assert settings.gyroscope_noise == PARTS["cheap"].gyroscope_noise
    rounding = 2.0 * np.pi / 2**14 / np.sqrt(12.0)
    assert settings.joint_position_noise == pytest.approx(np.linalg.norm([2e-4, rounding, 5e-3]))
    assert sensor_settings("ideal") == {}


def test_faults_are_reported():
    trial = EstimationTrial("go2", {"safety.activation_ramp": 0.0})
    trial.faults = [SlipperyFloor(duration=LONGEST, friction=0.0)]
    trial.stand()
    trial.follow([0.3], [trial.origin + [0.1, 0.1, 0.0]])
    with pytest.raises(NoSolution, match=r"FALLEN|IMPLAUSIBLE|NO_SOLUTION|fell"):
        trial.run(3.0)


@pytest.mark.parametrize(("factor", "share"), [(1.0, 0.95), (0.1, 0.0), (3.0, 0.0)])
def test_consistency_is_the_share_of_time_within_the_bounds(factor, share):
    within, mean = consistency(factor * np.random.default_rng(0).chisquare(5, (20, 2000)), 5)
    assert within == pytest.approx(share, abs=0.02)
    assert mean == pytest.approx(factor, rel=0.02)
    assert np.isnan(consistency([], 5)).all()


def test_chatter_is_the_torque_above_8_hz_and_mean_velocities_have_heading_axes():
    angle = 2.0 * np.pi * np.arange(0.0, 4.0, 0.002)
    slow, fast = 10.0 * np.sin(3.0 * angle), 2.0 * np.sin(30.0 * angle)
    torques = np.column_stack([slow, slow + fast])
    assert chatter(torques[:, :1], 500.0, np.array([100.0])) == pytest.approx(0.0, abs=1e-4)
    assert chatter(torques, 500.0, np.array([100.0, 100.0])) == pytest.approx(0.02 / np.sqrt(2.0), rel=0.02)
    times = np.linspace(0.0, 6.0, 601)
    way = np.cumsum(0.01 * (0.3 + 0.1j) * np.exp(0.5j * times))
    table = np.column_stack([times, way.real, way.imag, 0.5 * times])
    np.testing.assert_allclose(mean_velocity(table, 1.0, 5.0), [0.3, 0.1, 0.5], atol=1e-3)


class Motions:
    """Double of a trial with errors of the centre of mass of 5 mm, and 10 mm in the second motion."""

    made: "Motions"
    ends = False
    shift = origin = np.zeros(3)
    controller = SimpleNamespace(model=SimpleNamespace(actuators=("a", "b"), effort_limits=np.full(2, 10.0)))
    report = SimpleNamespace(command=SimpleNamespace(tau=np.ones(2)))

    def __init__(self, config, changes, force_sensors):
        Motions.made = self
        self.settings, self.asked, self.faults = config.settings, [], ()

    def stand(self):
        pass

    def follow(self, times, points):
        self.asked.append(np.array(points) - self.origin)

    def reference_com(self):
        return self.origin

    def com(self):
        return self.origin + len(self.asked) * np.array([0.003, 0.0, 0.004])

    def run(self, seconds, look):
        for _ in range(50):
            look()
        if self.ends and len(self.asked) == 2:
            raise NoSolution("FALLEN: it fell", "damping", None)


def test_flaw_errors_are_the_largest_distances(monkeypatch):
    monkeypatch.setattr("wbc_controller.validation.accuracy.flaws.EstimationTrial", Motions)
    cost = measure_flaw("go2", "joint friction 2 N·m", disturbance="never", known_friction=True)
    assert (cost.sway, cost.squat, cost.ended) == (pytest.approx(0.005), pytest.approx(0.010), "")
    settings, (sway, squat) = Motions.made.settings, Motions.made.asked
    assert (np.abs(sway).max(axis=0).tolist(), squat.min(axis=0).tolist()) == ([0.0, 0.03, 0.0], [0.0, 0.0, -0.05])
    assert (settings.estimation.base_state, settings.estimation.disturbance) == ("imu", "never")
    assert {friction.dry for friction in settings.robot.friction.values()} == {settings.mock.joint_friction} == {2.0}
    assert set(settings.robot.friction) == set(settings.robot.joints)
    monkeypatch.setattr(Motions, "ends", True)
    cost = measure_flaw("go2", "torques 20 % too small")
    assert [fault.actuator for fault in Motions.made.faults] == ["a", "b"]
    assert (cost.sway, cost.ended.startswith("FALLEN: it fell")) == (pytest.approx(0.005), True)
    assert np.isnan(cost.squat)


def test_tables_of_standing_and_flaws(monkeypatch, run):
    def made_up(robot, sensors, seed, seconds):
        tilt, drift = (0.001, 0.001, 0.002)[seed], 0.02 if robot == "g1" else 0.004
        return StandingErrors(tilt, 0.002, 0.003, drift, np.full(9, 5.0), np.full(9, 4.0))

    monkeypatch.setattr("wbc_controller.validation.accuracy.standing.stand", made_up)
    result = run("standing", "go2", "--seeds", "3")
    assert "| go2 | 0.081° (0.115°) | 2.00 mm | 3.0 mm/s | 4.0 mm | 100 %, 1.00 | 100 %, 1.00 | 0 |" in result.output
    assert result.exit_code == 0
    assert run("standing", "g1", "--seeds", "1").exit_code == 1  # excessive drift

    def made_up_flaw(robot, name, *settings):
        return FlawErrors(0.001, 0.002, 0.003, "FALLEN: it fell" if robot == "g1" else "")

    monkeypatch.setattr("wbc_controller.validation.accuracy.flaws.measure_flaw", made_up_flaw)
    result = run("flaws", "go2", "g1", "--flaw", "slope")
    assert "| slope 10°, force sensors | 1.0, 2.0; 0.3 % | ends: FALLEN |" in result.output
    assert result.exit_code == 1
    assert "unknown flaw 'nothing'" in str(run("flaws", "go2", "--flaw", "nothing").exception)
    assert len({flaw.name for flaw in FLAWS}) == len(FLAWS)


def test_mishap_with_force_sensors(monkeypatch):
    monkeypatch.setattr("wbc_controller.validation.accuracy.mishaps._DURATION", 0.3)
    found = run_mishap("go2", "IMU silent for 20 ms", force_sensors=True, changes=SHORT)
    assert (found.fault_texts, found.ended, found.silently_wrong, found.undetected) == ((), False, False, 0.0)
    assert 0.0 < found.error < 0.1


@pytest.mark.parametrize(
    ("robot", "name"), [("go2", "one foot slides at 0.6 m/s"), ("g1", "one foot on ice, friction 0.05")]
)
def test_slipping_foot_is_detected_and_the_robot_keeps_standing(monkeypatch, robot, name):
    """Before the friction of the foot was reduced, Go2 fell and G1 was damped."""
    monkeypatch.setattr("wbc_controller.validation.accuracy.mishaps._DURATION", 1.2)
    found = run_mishap(robot, name, changes=SHORT)
    assert found.left_out == (next(iter(load(robot).settings.contacts)),)
    assert (found.fault_texts, found.ended, found.fell) == ((), False, False)
    assert found.error < 0.06


@pytest.mark.parametrize(
    ("robot", "name"),
    [("g1", "gyroscope bias of 0.2 rad/s about x"), ("go2", "IMU shock of 5 rad/s for 1.5 s, on the hoist")],
)
def test_failed_imu_is_a_fault_and_the_robot_can_be_reactivated(monkeypatch, robot, name):
    monkeypatch.setattr("wbc_controller.validation.accuracy.mishaps._LIFT_TIME", 1.0)
    found = run_mishap(robot, name, changes={"safety.activation_ramp": 0.0})
    (sentence,) = found.fault_texts
    assert sentence.startswith("ESTIMATE_LOST: ")
    assert "the IMU contradicts all contacts" in sentence
    assert (found.silently_wrong, found.fell, found.ended) == (False, False, "hoist" not in name)
    assert 0.4 < found.recovery < 2.0  # 'reset' restarts the settling of 0.5 s


def test_table_of_mishaps(monkeypatch, run):
    fine, said = Outcome(0.01, 0.0, ()), ("NO_SOLUTION: there is none (daqp)",)
    found = {
        "one foot pulled up": Outcome(0.3, 0.1, ("left", "right"), said, ended=True, recovery=0.5),
        "gyroscope bias of 0.05 rad/s": Outcome(0.3, 0.31, ()),
    }
    monkeypatch.setattr(
        "wbc_controller.validation.accuracy.mishaps.run_mishap",
        lambda robot, name, *_: found.get(name, fine) if robot == "go2" else fine,
    )
    result = run("mishaps", "go2")
    row = "| go2 | one foot pulled up | ends; NO_SOLUTION: there is none | 0.300 m/s | 100 ms | 0.50 s | left, right |"
    assert row in result.output
    assert "| go2 | gyroscope bias of 0.05 rad/s | **silently wrong** | 0.300 m/s | 310 ms | – | – |" in result.output
    assert result.exit_code == 1
    assert run("mishaps", "g1").exit_code == 0
    found["one foot pulled up"], found["gyroscope bias of 0.05 rad/s"] = Outcome(0.3, 0.1, (), recovery=np.inf), fine
    result = run("mishaps", "go2")
    assert "| go2 | one foot pulled up | continues | 0.300 m/s | 100 ms | **refused** | – |" in result.output
    assert result.exit_code == 1
    assert Outcome(np.nan, np.nan, ()).silently_wrong
    assert Outcome(0.0, 0.0, (), fell=True).silently_wrong
    assert [longest_run(np.array(values, dtype=bool)) for values in ([], [0, 1, 1, 0, 1], [1, 1, 1])] == [0, 2, 3]


def test_a_fast_robot_walks_and_turns_on_its_estimate_and_stops(monkeypatch):
    """It fell when the trailing knee straightened at 0.8 m/s, or when the soft base made the stance foot tip over."""
    monkeypatch.setattr(walks, "_REACHED", 2.5)
    found = walk("g1", (0.5, 0.0, 0.1875), "good", 0, 3.5, 1.6)
    assert (found.ended, found.relaxed) == ("", 0)
    np.testing.assert_allclose(found.speed, [0.8, 0.0, 0.3], atol=0.08)
    assert found.drift < 0.02 * found.distance
