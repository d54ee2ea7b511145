"""A campaign runs the missing trials and reports errors."""

import contextlib
import io
import sys
from types import SimpleNamespace

import pytest
from command_line import wbc
from outcomes import outcome, repeatable
from refusals import refusal
from rich.console import Console

from wbc_controller.validation.campaign import run as run_module
from wbc_controller.validation.campaign.results import FILE, Results, TrialKey
from wbc_controller.validation.campaign.run import run_campaign


class Bench:
    """Trials without execution; their keys are stored."""

    def __init__(self, monkeypatch) -> None:
        self.keys = []
        self.outcome = outcome
        self.console = Console(file=io.StringIO(), width=150)
        monkeypatch.setattr(run_module, "run_trial", self.run)

    def run(self, robot, kind, seed, walking, *, recordings):
        assert not walking
        self.keys.append((robot, kind, seed))
        self.recordings = recordings
        return self.outcome(kind, seed, robot=robot)

    def campaign(self, folder, robots=("go2",), kinds=("kick", "push"), seeds=(0, 1), **options) -> bool:
        return run_campaign(robots, kinds, seeds, folder, console=self.console, **options)

    @property
    def said(self) -> str:
        return self.console.file.getvalue()


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_kinds_seeds_and_robots_are_combined(bench, tmp_path):
    assert bench.campaign(tmp_path, robots=("go2", "g1"))
    assert sorted(bench.keys) == sorted((r, k, s) for r in ("go2", "g1") for k in ("kick", "push") for s in (0, 1))
    assert "8 trials, 2 kinds of fault, 2 robots: 8 survived" in bench.said
    assert (tmp_path / "faults.md").exists()
    assert bench.recordings is None


def test_second_call_runs_missing_trials_and_reports_all(bench, tmp_path):
    bench.campaign(tmp_path, seeds=(0,))
    bench.keys.clear()
    assert bench.campaign(tmp_path, seeds=(0, 1), recordings=tmp_path / "recordings")
    assert sorted(bench.keys) == [("go2", "kick", 1), ("go2", "push", 1)]
    assert bench.recordings == tmp_path / "recordings"
    assert "2 of 4 trials exist already" in bench.said
    assert "4 trials, 2 kinds" in bench.said


def test_interrupted_campaign_keeps_its_results(bench, tmp_path):
    def interrupted(kind, seed, **rest):
        if len(bench.keys) == 3:
            raise KeyboardInterrupt
        return outcome(kind, seed, **rest)

    bench.outcome = interrupted
    assert not bench.campaign(tmp_path)
    assert "interrupted" in bench.said
    assert len((tmp_path / FILE).read_text(encoding="utf-8").splitlines()) == 2
    bench.outcome = outcome
    bench.keys.clear()
    assert bench.campaign(tmp_path)
    assert len(bench.keys) == 2


def test_violation_is_reported_with_its_command(bench, tmp_path):
    bench.outcome = lambda kind, seed, **rest: outcome(
        kind, seed, **rest, **({"result": "violation", "violations": {"stale": "old"}} if kind == "push" else {})
    )
    assert not bench.campaign(tmp_path)
    assert "worst trial: go2, push, seed 0: stale: old" in bench.said
    assert "repeat with: wbc faults go2 --kinds push --seed 0" in bench.said


def test_unused_results_are_reported(bench, tmp_path, monkeypatch):
    bench.campaign(tmp_path)
    monkeypatch.setattr("wbc_controller.validation.campaign.results.version_of", lambda robot: "another")
    bench.keys.clear()
    bench.campaign(tmp_path)
    assert len(bench.keys) == 4
    assert "4 trials of another version of the code or the robot are ignored" in " ".join(bench.said.split())


def test_unknown_names_and_missing_packages_are_refused(bench, tmp_path, monkeypatch):
    for options, said in (
        ({"kinds": ("kik",)}, "unknown kind of fault 'kik'; did you mean 'kick'"),
        ({"robots": ("go3",)}, "unknown configuration 'go3'"),
        ({"backend": "threads"}, "unknown backend 'threads'; Valid: dask, loky, ray"),
        ({"address": "tcp://x:1"}, "--address 'tcp://x:1': not valid for the backend loky"),
    ):
        assert said in refusal(bench.campaign, tmp_path, **options)
    for backend, missing in (("dask", "distributed"), ("ray", "ray"), ("loky", "joblib")):
        monkeypatch.setitem(sys.modules, missing, None)
        assert missing in refusal(bench.campaign, tmp_path, backend=backend)
    assert not bench.keys


def test_a_module_missing_during_a_campaign_on_dask_is_not_reported_as_the_backend(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=contextlib.nullcontext))
    with pytest.raises(ModuleNotFoundError, match="mujoco"), run_module._cluster("dask", None):
        raise ModuleNotFoundError("No module named 'mujoco'")


def stalled(seconds):
    return {"result": "violation", "violations": {"stall": f"{1e3 * seconds:.1f} ms"}, "longest": seconds}


@pytest.mark.parametrize(("again", "good"), [({"longest": 0.002}, True), (stalled(0.035), False)])
def test_stall_counts_only_after_a_repetition(bench, tmp_path, monkeypatch, again, good):
    repeated = []

    def in_new_process(key, trial):
        repeated.append(key)
        return outcome(key.kind, key.seed, robot=key.robot, **again)

    monkeypatch.setattr(run_module, "_in_new_process", in_new_process)
    bench.outcome = lambda kind, seed, **rest: outcome(
        kind, seed, **rest, **(stalled(0.03) if (kind, seed) == ("push", 1) else {})
    )
    assert bench.campaign(tmp_path) is good
    assert repeated == [TrialKey("go2", "push", 1)]
    sentence = "go2, push, seed 1 was repeated: its longest cycle took 30.0 ms of processor time, and "
    sentence += f"{1e3 * again['longest']:.1f} ms in a new process"
    assert sentence in " ".join(bench.said.split())
    assert sentence in (tmp_path / "faults.md").read_text(encoding="utf-8")
    assert bench.campaign(tmp_path) is good  # from the file, without another repetition
    assert len(repeated) == 1
    assert len((tmp_path / FILE).read_text(encoding="utf-8").splitlines()) == 5


def test_trial_is_the_same_in_a_new_process_and_in_one_of_the_command(tmp_path):
    key = TrialKey("go2", "estop", 4)
    here = repeatable(run_module.run_trial(*key))
    assert repeatable(run_module._in_new_process(key, run_module.run_trial)) == here
    result = wbc("faults", "go2", "--kinds", "estop,kick", "--seed", "4", "--jobs", "2", "--out", tmp_path)
    said = "1 of 1 faults with a deadline were detected in time; 0 trials with violations"
    assert said in " ".join(result.output.split())
    with contextlib.closing(Results(tmp_path)) as results:
        assert repeatable(results.outcomes[key]) == here
