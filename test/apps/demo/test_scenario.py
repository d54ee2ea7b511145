from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal

import wbc_controller as wbc
from wbc_controller.apps.demo import director, run
from wbc_controller.apps.demo.derived_scenario import derived_scenario
from wbc_controller.apps.demo.run import run_demo
from wbc_controller.apps.demo.scenario import SCENARIOS, WALK_ROBOT, WALK_SCENARIO
from wbc_controller.settings.files import shipped_configurations


def test_only_robots_that_stand_have_a_demo(robot_of):
    assert set(SCENARIOS) == set(shipped_configurations()) == {"g1", "talos", "go2"}
    settings, model = robot_of("go2")
    without = settings.model_copy(update={"contacts": {}, "walking": None})
    assert "the demo requires a standing robot" in refusal(derived_scenario, without, model)
    posture = settings.model_copy(update={"tasks": {"posture": settings.tasks["posture"]}})
    assert "the demo requires an enabled task of type com" in refusal(derived_scenario, posture, model)


@pytest.mark.parametrize("robot", SCENARIOS)
def test_demos_use_configured_tasks(robot, robot_of):
    scenario, (settings, _) = SCENARIOS[robot], robot_of(robot)
    assert settings.tasks["com"].type == "com"
    for reach in scenario.reaches:
        assert settings.tasks[reach.task].type == "frame_pose"
        assert reach.duration > settings.tasks[reach.task].setpoint_duration
    names = [part.name for part in (*scenario.moves, *scenario.shoves)]
    assert len(set(names)) == len(names)
    for move in scenario.moves:  # in order of time, with the end at the start position
        times = [time for time, _ in move.points]
        assert times[0] > 0.0
        assert times == sorted(set(times))
        assert move.duration == times[-1]
        assert not np.any(move.points[-1][1])
        assert np.any(move.points[0][1])
    assert 0.0 < scenario.force_target <= 0.01
    assert 0.0 < scenario.recovery_target <= 0.02
    assert all(0.0 < move.target_rms <= 0.01 for move in scenario.moves)
    assert all(0.0 < reach.target <= 0.01 for reach in scenario.reaches)
    directions = np.array([shove.impulse for shove in scenario.shoves])
    np.testing.assert_array_equal(directions.sum(axis=0), np.zeros(3))
    assert np.linalg.matrix_rank(directions) == 2


@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_derived_scenario_is_similar_to_the_supplied_one(robot, robot_of):
    settings, model = robot_of(robot)
    derived, made = derived_scenario(settings, model), SCENARIOS[robot]
    for ours, theirs in zip(derived.moves, made.moves, strict=True):
        assert ours.name == theirs.name
        amplitude, known = (np.abs([at for _, at in move.points]).max() for move in (ours, theirs))
        assert 0.2 * known < amplitude < 1.5 * known
    assert len(derived.shoves) == 4
    for ours, theirs in zip(derived.shoves, made.shoves, strict=True):
        assert 0.2 < np.linalg.norm(ours.impulse) / np.linalg.norm(theirs.impulse) < 1.5
    assert len(derived.reaches) == len(made.reaches)


def test_demo_of_walking(tmp_path, monkeypatch, capsys):
    """A short walk meets its targets and stops; the speeds of the whole one are within those of the robot."""
    short = replace(WALK_SCENARIO.walks[0], duration=3.5, acceleration=2.1)
    monkeypatch.setattr(director, "_SETTLING_TIME", 0.1)  # exact sensors do not need more
    monkeypatch.setattr(run, "WALK_SCENARIO", replace(WALK_SCENARIO, stand=0.1, walks=(short,), stop=2.5))
    assert run_demo("walk", tmp_path, lockstep=True)
    said = capsys.readouterr().out
    assert [word in said for word in ("walk forward", "stop", "g1", "all targets met")] == [True, True, False, True]
    fastest = np.array(wbc.Controller(WALK_ROBOT).walker.gait.speed)
    for walk in WALK_SCENARIO.walks:
        assert (np.abs(walk.velocity) <= fastest).all()
        assert walk.duration > walk.acceleration
