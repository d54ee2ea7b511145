"""Replay of recordings: bit for bit, explanation, comparison, report."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from command_line import wbc
from recorded_run import copied, make_run

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.recording.replay.cycle_replay import Comparison, Replay
from wbc_controller.recording.replay.recording_summary import summarize
from wbc_controller.recording.report.run_data import make_run_data


def busy(run, make) -> None:
    """Stand, with changes of references, weights, gains and contacts."""
    bench = run.bench
    run.stand(20)
    bench.send("setpoint", make.point(bench.loop.controller.dynamics.com + [0.01, 0.0, -0.02]), "com")
    run.go(20)
    bench.send("update", make.string("{tasks: {com: {stiffness: 150.0, weight: 3.0}}, control: {weight_ramp: 0.1}}"))
    run.go(30)
    bench.send("contact_enable", make.bool(False), "front_left_foot")
    run.go(20)
    bench.command("deactivate")
    run.go(10)
    bench.command("activate")
    run.go(150)


@pytest.fixture(scope="module")
def original(bench, tmp_path_factory, make):
    folder = tmp_path_factory.mktemp("busy")
    run = make_run(bench, folder, folder / "a.mcap")
    busy(run, make)
    return run.finish().path


@pytest.fixture
def recorded(original, tmp_path):
    return copied(original, tmp_path)


def test_replay_from_any_memory_is_identical(recorded):
    assert sorted(recorded.memories)[0] == 0
    middle = sorted(recorded.memories)[-1]
    assert 100 <= middle < recorded.last
    replay = Replay(recorded)
    solved = [(each.cycle.number, each.is_identical, each.exact) for each in replay.run()]
    assert solved == [(i, True, True) for i in range(recorded.count)]
    assert replay.skipped == 0
    later = [(each.cycle.number, each.is_identical) for each in replay.run(recorded.last)]
    assert later == [(i, True) for i in range(middle, recorded.count)]
    assert any(each.result.solution is not None for each in replay.run(5, 8))


def test_walking_commands_are_replayed(record, tmp_path, make):
    run = record(tmp_path / "w.mcap", robot="g1")
    bench = run.bench
    run.stand(20)
    bench.send("walk_goal", make.pose([1.0, 0.5, 0.0], [0.0, 0.0, np.sin(0.2), np.cos(0.2)]))
    run.go(60)
    bench.send("walk_footsteps", make.pose_array([[0.1, 0.12, 0.0], [0.2, -0.12, 0.1]]))
    run.go(400)
    assert bench.loop.controller.walker.footsteps_left == 2
    assert len(bench.reports[-1].solution.forces) == 1  # in the air
    bench.send("cmd_vel", make.velocity("cmd_vel", [0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    run.go(40)
    recorded = run.finish()
    assert [each.is_identical for each in Replay(recorded).run()] == [True] * recorded.count
    text = summarize(recorded)
    assert all(words in text for words in ("walk to 1, 0.5 m and 0.4 rad", "walk by 2 footsteps", "walk at 0.2, 0 m/s"))


def test_the_memory_contains_the_estimated_disturbance(record, tmp_path, make):
    friction = {"FL_calf_joint": {"dry": 0.5, "viscous": 0.1}}
    run = record(tmp_path / "b.mcap", {"estimation": {"disturbance": "always"}, "robot": {"friction": friction}})
    busy(run, make)
    replay = Replay(run.finish())
    middle = sorted(replay.recorded.memories)[-1]
    solved = list(replay.run(replay.recorded.last))
    expected = [(i, True) for i in range(middle, replay.recorded.count)]
    assert [(each.cycle.number, each.is_identical) for each in solved] == expected
    assert np.abs(solved[-1].result.solution.disturbance.estimate).max() > 0.0


def test_a_bit_that_is_another_one_is_found(recorded):
    solved = list(Replay(recorded).run(0, 30))
    assert all(each.is_identical for each in solved)
    cycle = solved[-1].cycle
    for name in ("tau", "v_dot"):
        values = {**cycle.values, name: np.nextafter(cycle.values[name], np.inf)}
        assert not replace(solved[-1], cycle=replace(cycle, values=values)).is_identical
    recorded.events[3]["requests"] = []  # not active then
    assert [each.is_identical for each in Replay(recorded).run(0, 6)] == [True] * 3 + [False] * 4


def test_cycles_after_a_missing_event_are_skipped(recorded):
    """An event is written after its cycle: a killed controller may have written only the cycle."""
    asked = max(number for number, event in recorded.events.items() if "requests" in event)
    del recorded.events[asked]
    behind = sorted(number for number in recorded.memories if number > asked)
    begun = behind[0]
    replay = Replay(recorded)
    solved = list(replay.run())
    assert [each.cycle.number for each in solved] == [*range(asked), *range(begun, recorded.count)]
    assert all(each.is_identical for each in solved)
    assert replay.skipped == begun - asked
    for number in behind:
        del recorded.memories[number]
    assert [each.cycle.number for each in replay.run()] == [*range(asked)]
    assert replay.skipped == recorded.count - asked


def test_after_a_failed_cycle_the_replay_resumes_at_the_next_memory(record, tmp_path, monkeypatch):
    run = record(tmp_path / "a.mcap")
    run.stand(20)
    controller = run.bench.loop.controller
    supervisor = controller.supervisor
    step = supervisor.step
    monkeypatch.setattr(supervisor, "step", lambda *words: [step(*words), 1 / 0])
    with pytest.raises(ZeroDivisionError):
        run.go(1)
    monkeypatch.undo()
    controller.fail(ZeroDivisionError("once"))  # as `ControlLoop` does
    run.go(60)
    recorded = run.finish()
    (fault,) = recorded.faults.values()
    assert fault.code == "INTERNAL_ERROR"
    replay = Replay(recorded)
    solved = list(replay.run())
    assert all(each.is_identical for each in solved)
    assert 0 < replay.skipped <= 16
    assert len(solved) + replay.skipped == recorded.count


def test_a_cycle_whose_torques_were_not_sent_is_replayed(record, tmp_path, monkeypatch):
    """The process stopped for 60 ms during a cycle, which was repeated with stale inputs."""
    run = record(tmp_path / "a.mcap")
    run.stand(20)
    controller, clock = run.bench.loop.controller, run.bench.clock
    cycle = controller.cycle

    def slow(inputs):
        result = cycle(inputs)
        clock.time += 0.06 * (inputs.problem is None)
        return result

    monkeypatch.setattr(controller, "cycle", slow)
    run.go(1)
    monkeypatch.undo()
    run.go(5)
    recorded = run.finish()
    assert [fault.code for fault in recorded.faults.values()] == ["STALE_INPUT"]
    assert len([event for event in recorded.events.values() if "torques sent" in event]) == 1
    assert [each.is_identical for each in Replay(recorded).run()] == [True] * recorded.count


def test_a_recording_that_begins_later_is_solved_from_its_first_memory_on(record, tmp_path):
    run = record(changes={"recorder": {"seconds": 0.3, "folder": str(tmp_path / "faults")}})
    run.stand(900)
    run.recorder.request()
    run.go(2)
    recorded = run.finish()
    assert recorded.first > 0
    replay = Replay(recorded)
    solved = [each.is_identical for each in replay.run()]
    assert len(solved) == recorded.count - replay.skipped > 0
    assert all(solved)


def test_a_solver_with_a_memory_of_its_own_is_exact_from_the_start_alone(record, tmp_path):
    # Not ProxQP: its last bits differ between two objects with equal problems.
    run = record(tmp_path / "a.mcap", {"solver": {"name": "osqp"}})
    run.stand(130)
    recorded = run.finish()
    assert all(each.is_identical and each.exact for each in Replay(recorded).run(0, 60))
    later = list(Replay(recorded).run(125))
    assert not any(each.exact for each in later)
    assert max(each.difference for each in later) < 1.0e-2


def test_the_commands(recorded, tmp_path):
    path = recorded.path
    said = wbc("replay", path).output
    assert f"{recorded.count} cycles replayed: all torques are equal bit for bit" in said
    for words in ("no fault", "command activate", "contact front_left_foot off", "settings changed"):
        assert words in said
    said = wbc("replay", path, "--cycle", 60).output
    for words in ("cycle 60 at", "com", "bit for bit", "equations_of_motion", "joint_states", "share of the solution"):
        assert words in said
    said = wbc("replay", path, "--cycle", 99999, status=2).output
    assert f"--cycle 99999: valid: 0 to {recorded.last}" in said
    (tmp_path / "b.mcap").write_bytes(path.read_bytes()[:40])
    wbc("replay", tmp_path / "b.mcap", status=2)
    (tmp_path / "c.mcap").write_text("a text")
    assert "not an MCAP file" in wbc("replay", tmp_path / "c.mcap", status=2).output


def test_comparison_with_another_configuration(recorded, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text(recorded.config.replace({"tasks.com.stiffness": 400.0}).to_yaml())
    plots = tmp_path / "plots.html"
    said = wbc("replay", recorded.path, "--config", other, "--plot", plots).output
    assert "different modes in 0 cycles, " in said
    assert float(re.search(r"largest torque difference ([\d.]+) N", said).group(1)) > 1e-3
    assert "Plotly.newPlot" in plots.read_text()
    same = Comparison(recorded, recorded.config)
    np.testing.assert_allclose(same.other[:20], same.recorded[:20], atol=1e-9)
    slippery = Comparison(recorded, recorded.config.replace({"contacts.front_left_foot.friction": 0.02}))
    assert ["cone:front_left_foot" in counts for counts in slippery.binding] == [False, True]
    same = recorded.config.replace({"tasks.com.stiffness": 150.0})  # after its update
    light = same.replace({"tasks.com.weight": 0.01, "tasks.base.weight": 500.0})
    for config, differs in ((same, False), (light, True)):  # from a later memory, with its weights
        solved = [each for each in Replay(recorded, config).run(recorded.last) if each.cycle.number > recorded.last - 5]
        assert [each.difference > 1e-3 for each in solved] == [differs] * 5
    said = wbc("replay", recorded.path, "--config", "g1", status=2).output
    assert "the joints must be those of the recording" in said
    wbc("replay", recorded.path, "--plot", plots, status=2)


def test_a_long_story_is_cut_in_the_middle(recorded):
    recorded.events.update({1000 + i: {**recorded.events[3], "cycle": 1000 + i} for i in range(200)})
    recorded.count -= 5
    said = summarize(recorded).splitlines()
    assert said[1].startswith("5 cycles were dropped: ")
    assert len(said) < 60
    assert sum(line.endswith(" more") for line in said) == 1
    assert "cycle 1199" in said[-1]


def test_the_report_of_a_recording_has_no_simulation_truth(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr("wbc_controller.recording.report.run_report.make_run_data", partial(make_run_data, largest=100))
    every = -(-recorded.count // 100)
    said = wbc("report", recorded.path, "--out", tmp_path / "a.html").output
    assert "does not contain the true contact forces" in said
    page = (tmp_path / "a.html").read_text()
    assert f"One of {every} cycles is shown." in page
    assert "does not contain the true contact forces" in page
    assert '"name":"force of the ground"' not in page
    controller = ControlCycle(recorded.config, preflight=False)
    fewer, made = make_run_data(recorded, controller, largest=100), make_run_data(recorded, controller)
    assert (fewer.stride, made.stride) == (every, 1)
    assert every > 1
    assert len(fewer.time) == pytest.approx(len(made.time) / every, abs=1)
    assert not made.true_wrenches
    assert made.tau.shape == (len(made.time), 12)
    assert [mode for _, mode in made.modes] == ["active", "inactive", "active"]
    assert made.com_reference[60, 0] > made.com_reference[20, 0]
    assert (np.diff(made.com_reference[22:38, 0]) > 0.0).all()  # in every cycle, without a weight ramp
    assert np.isfinite(made.task_errors["com"]).all()
    assert [name for _, name in made.phases] == ["activate", "deactivate", "activate"]
