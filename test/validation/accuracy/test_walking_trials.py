"""Trials of walking: unknown ground, pushes, starts and stops; their figures and tables."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refusal

from wbc_controller.settings.config import load
from wbc_controller.validation.accuracy import walk_pushes, walks
from wbc_controller.validation.accuracy.walk_pushes import LARGEST, RESOLUTION, Push, ends, largest_impulse
from wbc_controller.validation.accuracy.walks import GROUNDS, Starts, Walk, WalkFigures, WalkMeter, terrain_of
from wbc_controller.walking.gait import Phase


def test_grounds_are_valid_and_begin_flat():
    for ground in GROUNDS:
        settings = load("g1").replace(terrain_of(ground, 3)).settings
        assert settings.mock.terrain.keys() or ground in ("flat", "slippery")
    cells = load("g1").replace(terrain_of("uneven", 3)).settings.mock.terrain["cells"]
    assert (cells.seed, cells.unevenness) == (3, 0.02)
    assert "unknown ground 'ice'; " in refusal(terrain_of, "ice", 0)


class Cycles:
    """A trial that repeats prescribed torques, forces and places of one foot."""

    def __init__(self, taus, phases, places, force=(0.0, 0.0, 100.0)):
        self._cycles = iter(zip(taus, phases, places, strict=True))
        self.settings = SimpleNamespace(limits=SimpleNamespace(torque_rate=100.0), control=SimpleNamespace(rate=500.0))
        self.model = SimpleNamespace(effort_limits=np.array([10.0]))
        cone = np.array([[1.0, 0.0, -0.5]])  # f_x <= 0.5 f_z
        self.controller = SimpleNamespace(
            walker=SimpleNamespace(phase=Phase.STAND), qp=SimpleNamespace(contacts={"foot": SimpleNamespace(cone=cone)})
        )
        self._force = np.array(force)
        self.mock = SimpleNamespace(plant=SimpleNamespace(foot_placement=lambda name: self.place))

    def cycles(self):
        for tau, phase, place in self._cycles:
            self.controller.walker.phase = phase
            self.place = SimpleNamespace(translation=np.array([place, 0.0, 0.0]))
            self.report = SimpleNamespace(
                command=SimpleNamespace(tau=np.array([tau])), solution=SimpleNamespace(forces={"foot": self._force})
            )
            yield


def metered(trial):
    meter = WalkMeter(trial)
    for _ in trial.cycles():
        meter.update()
    return meter.figures()


def test_figures_of_a_walk():
    """The torque rate counts at touchdown only; a slip counts after the foot has settled."""
    taus = [0.0, 1.9, 1.9, 2.9, 2.9, 2.9, 2.9, 2.9, 4.8]  # 2 N·m in a cycle is the limit
    phases = [Phase.SINGLE] * 3 + [Phase.DOUBLE] * 6
    found = metered(Cycles(taus, phases, [0.0] * 9))
    assert found.rate == pytest.approx(0.5)
    assert found.torque == pytest.approx(0.48)
    places = np.concatenate([np.linspace(0.0, 0.01, 25), np.full(20, 0.01), np.full(5, 0.014)])
    found = metered(Cycles([0.0] * 50, [Phase.SINGLE] * 50, places))
    assert found.slip == pytest.approx(0.004, abs=5e-4)
    assert metered(Cycles([0.0], [Phase.STAND], [0.0])).outside == 0.0
    assert metered(Cycles([0.0], [Phase.STAND], [0.0], (60.0, 0.0, 100.0))).outside == pytest.approx(10.0)


def test_the_bisection_finds_the_largest_impulse(monkeypatch):
    monkeypatch.setattr(walk_pushes, "ends", lambda robot, push, speed, *_: ("fell" if speed > 0.7 else "", 35.0))
    assert 0.7 - RESOLUTION * LARGEST <= largest_impulse("g1", Push(0.0, None), "ideal", 0) / 35.0 <= 0.7


def test_a_robot_that_steps_survives_a_push_and_falls_at_a_large_one(monkeypatch):
    monkeypatch.setattr(walk_pushes, "AFTER", 0.8)
    monkeypatch.setattr(walk_pushes, "_STEPS", 1)
    assert ends("g1", Push(0.0, 0.25), 0.2, "ideal", 0)[0] == ""
    fell, mass = ends("g1", Push(0.0, None), LARGEST, "ideal", 0)
    assert re.search("FALLEN|FALLING|fell|NO_SOLUTION", fell)
    assert mass == pytest.approx(33.3, abs=2.0)


@pytest.mark.parametrize(("falls", "status"), [(1, 0), (2, 1)])
def test_table_of_grounds(monkeypatch, run, falls, status):
    figures = WalkFigures(torque=0.8, rate=0.25, chatter=0.012, slip=0.003, outside=0.0)

    def walk_on(robot, ground, sensors, seed, seconds):
        return Walk(np.zeros(3), 2.0, 0.0, 0, "3.2 s: FALLEN: it fell" if seed < falls else "", figures)

    monkeypatch.setattr(walks, "walk_on", walk_on)
    result = run("walking-grounds", "g1", "--ground", "up")
    assert f"| g1 | up | 2.0 m | 0 | 0.80 | 0.25 | 1.2 % | 3.0 mm | 0 N | {falls} of 10 |" in result.output
    assert "g1, up, seed 0: 3.2 s: FALLEN: it fell" in result.output
    assert result.exit_code == status


@pytest.mark.parametrize(("steps", "ended", "status"), [((1, 3), "", 0), ((1, 4), "", 1), ((1,), "4.0 s: FALLEN", 1)])
def test_table_of_starts(monkeypatch, run, steps, ended, status):
    monkeypatch.setattr(walks, "start_and_stop", lambda robot, sensors, seed, count: Starts(steps, ended))
    result = run("walking-starts", "g1", "--seeds", "2")
    counts = ", ".join(f"{number}: 2" for number in steps)
    assert f"| g1 | {2 * len(steps)} | {counts} | {2 * bool(ended)} |" in result.output
    assert result.exit_code == status


@pytest.mark.parametrize(("walking", "falls", "status"), [(30.0, 0, 0), (29.0, 0, 1), (30.0, 1, 1)])
def test_table_and_plot_of_pushes(monkeypatch, run, tmp_path, walking, falls, status):
    def change_velocity(robot, sensors, seed, seconds):
        return "2.0 s: FALLEN" if seed < falls else ""

    def largest_impulse(robot, push, sensors, seed):
        return 20.0 if push.phase is None else walking + push.phase

    monkeypatch.setattr(walk_pushes, "change_velocity", change_velocity)
    monkeypatch.setattr(walk_pushes, "largest_impulse", largest_impulse)
    options = ("--directions", "4", "--phases", "2", "--changes", "10", "--plot", str(tmp_path / "pushes.html"))
    result = run("walking-pushes", "g1", *options)
    assert f"| 90° | 20.0 N·s | {walking:.1f} N·s | {walking + 0.25:.1f} N·s | {walking / 20.0:.2f} |" in result.output
    assert f"{falls} of 10 fell" in result.output
    assert result.exit_code == status
    assert "scatterpolar" in (tmp_path / "pushes.html").read_text()


@pytest.mark.parametrize("command", ["walking-grounds", "walking-starts", "walking-pushes"])
def test_an_unknown_robot_is_refused(run, command):
    assert "unknown configuration 'nobody'" in str(run(command, "nobody").exception)


@pytest.fixture
def saved(tmp_path):
    """Return a function that writes the configuration of G1 with changes, and returns the path."""

    def save(**walking):
        path = tmp_path / "robot.yaml"
        path.write_text(load("g1").replace({"walking": walking or None}).to_yaml(), encoding="utf-8")
        return str(path)

    return save


def test_other_robots_walk_at_their_largest_speeds(saved):
    commands = walks.commands_of(saved(max_speed=0.3))
    assert (commands["forward"], commands["backward"]) == ((0.3, 0.0, 0.0), (-0.15, 0.0, 0.0))


def test_a_robot_without_walking_is_refused(saved):
    assert "cannot walk: its configuration has no section 'walking'" in refusal(walks.commands_of, saved())


def test_an_unknown_command_beside_a_valid_one_is_refused(run):
    words = ("--command", "turn", "--command", "fly", "--seeds", "1", "--seconds", "6")
    assert "unknown command 'fly'" in str(run("walking", "go2", *words).exception)
