"""Comparison of `make bench`, with our own cycle in place of the rivals."""

import contextlib
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import compare
import contestants
import numpy as np
import pinocchio as pin
import pytest
import scenes
from contestants import Answers
from our_cycle import Cycle

from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.records import Reference


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> scenes.Scene:
    return scenes.make(scenes.CASES["go2-two"], 30, tmp_path_factory.mktemp("scene"))


def answered(scene: scenes.Scene) -> list:
    """Return our solutions of all states, in this process."""
    cycle = Cycle(scene.settings, scene.model)
    rest = cycle.start(scene.q)
    found = []
    for row in scene.rows:
        q, v, reference = np.split(row, [scene.model.nq, scene.model.nq + scene.model.nv])
        cycle.step(cycle.state(q, v), scenes.with_com(rest, Reference(*np.split(reference, 3))))
        found.append(cycle.solution)
    return found


def test_worker_process_and_local_cycle_agree_bitwise(scene):
    with contestants.ours(scene.message(), "broken") as process:
        first, second = process.solve(scene.rows[:10]), process.solve(scene.rows[10:], 2**20)
        fallen = scene.rows[:1].copy()
        fallen[0, scene.model.nq + 6 :] = 1.0e6  # rad/s: the supervisor leaves its active mode
        with pytest.raises(SystemExit, match="the process of broken ended; see its output above"):
            process.solve(np.repeat(fallen, 200, axis=0))
    for i, solution in enumerate(answered(scene)):
        answers, place = (first, i) if i < 10 else (second, i - 10)
        assert np.array_equal(answers.v_dot[place], solution.v_dot)
        assert np.array_equal(answers.tau[place], solution.tau)
        assert np.array_equal(answers.forces[place], np.concatenate(list(solution.forces.values())))
    assert process.hello["parts"] == ["build", "solve", "unpack", "supervise"]
    for answers in (first, second):
        assert np.allclose(answers.parts.sum(axis=1), answers.seconds)
        assert (answers.seconds > 0.0).all()


def test_floor_has_the_size_of_accelerations_and_forces(scene):
    with contestants.floor(scene.message()) as process:
        answers = process.solve(scene.rows[:5])
    assert process.hello["unknowns"] == scene.model.nv + 6
    assert answers.v_dot.shape == (5, 0)
    assert np.allclose(answers.parts.sum(axis=1), answers.seconds)


def test_ended_process_is_named(scene, capfd):
    with pytest.raises(SystemExit, match="the process of broken ended before it was ready"):
        contestants.ours({**scene.message(), "joints": ["elbow"]}, "broken")
    assert "expected ['elbow']" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--cases", "go3"], "--cases: unknown name 'go3'"),
        (["--rivals", "tsit"], "--rivals: unknown name 'tsit'"),
        (["--blocks", "0"], "--blocks 0; valid: at least 1"),
        (["--against", "no-such-commit", "--cases", "go2-two"], "--against: unknown commit 'no-such-commit'"),
    ],
)
def test_unknown_cases_rivals_and_commits_are_refused(arguments, sentence):
    with pytest.raises(SystemExit, match=sentence):
        compare.main(arguments)


def test_contestants_get_all_states_in_turn(monkeypatch):
    monkeypatch.setattr(compare, "FILLING", 8)
    asked = []

    def solve(name, rows, touched=0):
        asked.append((name, touched, rows[:, 0].tolist()))
        return Answers(*(rows for _ in range(4)), rows[:, 0])

    parties = [SimpleNamespace(name=name, solve=lambda *asked, name=name: solve(name, *asked)) for name in ("a", "b")]
    rows = np.arange(60.0)[:, None]
    warm, cold = compare.take_turns(parties, rows, blocks=2, warm=20, cold=10, touched=7)
    assert [(name, touched, states[0], len(states)) for name, touched, states in asked] == [
        *(("a", 0, 0.0, 20), ("b", 0, 0.0, 20), ("a", 7, 20.0, 10), ("b", 7, 20.0, 10)),
        *(("a", 0, 30.0, 20), ("b", 0, 30.0, 20), ("a", 7, 50.0, 10), ("b", 7, 50.0, 10)),
    ]
    assert [block.seconds.tolist() for block in warm["b"]] == [[*range(8, 20)], [*range(38, 50)]]
    assert [block.seconds.tolist() for block in cold["a"]] == [[*range(20, 30)], [*range(50, 60)]]


@pytest.mark.parametrize("name", ["talos-full", "g1-single"])
def test_robot_of_the_rivals_has_contact_frames(name, tmp_path):
    scene = scenes.make(scenes.CASES[name], 1, tmp_path)
    told = scene.message()
    model = pin.buildModelFromXML(told["urdf"], pin.JointModelFreeFlyer())
    assert list(model.names)[2:] == told["joints"]
    model.armature = np.array(told["armature"])
    data = model.createData()
    cycle = Cycle(scene.settings, scene.model)
    dynamics = cycle.controller.dynamics
    v = np.random.default_rng(0).normal(size=model.nv)
    dynamics.update(scene.q, v)
    pin.computeAllTerms(model, data, scene.q, v)
    assert np.allclose(dynamics.M, data.M, atol=1e-9)
    assert np.allclose(dynamics.h, data.nle, atol=1e-8)
    pin.updateFramePlacements(model, data)
    feet = []
    for contact in told["contacts"]:
        ours: Contact = cycle.controller.contacts[contact["name"]]
        feet.append(ours.points(dynamics).mean(axis=0))
        assert np.allclose(data.oMf[model.getFrameId(contact["frame"])].translation, feet[-1], atol=1e-8)
    assert len(feet) == len(scene.case.feet)
    if len(feet) == 1:  # moved over the only foot
        assert np.linalg.norm((dynamics.com - feet[0])[:2]) < 0.01


@pytest.fixture(scope="module")
def commit() -> str:
    """The present commit."""
    head = subprocess.run(["git", "-C", str(contestants.ROOT), "rev-parse", "HEAD"], capture_output=True, text=True)
    if head.returncode:
        pytest.skip("not a git checkout: there is no older commit to compare with")
    return head.stdout.strip()[:9]


def test_files_of_a_commit_are_importable(commit):
    with contestants.code_of(commit) as folder:
        command = [sys.executable, "-c", "import wbc_controller.settings.files as f; print(f.__file__)"]
        environment = {**os.environ, "PYTHONPATH": str(folder)}
        said = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout
        assert said.startswith(str(folder))
    assert not folder.exists()


def test_older_code_and_services_are_timed(capsys, monkeypatch, commit):
    """The older code is this folder, with its compiled kernels."""
    monkeypatch.setattr(contestants, "code_of", lambda of: contextlib.nullcontext(contestants.ROOT))
    monkeypatch.setattr(scenes, "SERVICES", ("go2",))
    monkeypatch.setattr(compare, "WARM", 30)
    monkeypatch.setattr(compare, "FILLING", 10)
    monkeypatch.setattr(compare, "COLD", 5)
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    compare.main(["--against", commit, "--cases", "go2-four", "go2-service", "--rivals", "none", "--blocks", "1"])
    assert allowed is None or os.sched_getaffinity(0) == allowed
    said = capsys.readouterr().out
    older = f"at {commit}"
    assert f"largest differences of {older} from ours: v̇ " in said
    for row in ("floor", "ours", older):
        cells = re.search(rf"^{row} +(\d+) +(\d+) +(\d+) ", said, flags=re.MULTILINE)
        assert cells is not None
        assert int(cells[1]) <= int(cells[2]) <= int(cells[3])
    assert re.search(rf"^{older} .*\(\d", said, flags=re.MULTILINE)
    services = said[said.index("go2 as supplied, messages to messages") :]
    assert "read" in services
    assert "processor" in services
    assert f"largest difference of {older} from ours: τ " in services
    assert "supervise" in said[: said.index("go2 as supplied")]
    shares = said[said.index("our share, warm/cold") :]
    assert re.search(r"^go2-four +\d+\.\d\d/\d+\.\d\d +\d+\.\d\d/\d+\.\d\d$", shares, flags=re.MULTILINE)
    assert re.search(r"^go2-service +\d+\.\d\d/\d+\.\d\d$", shares, flags=re.MULTILINE)


def test_older_code_is_not_the_installed_package(scene, tmp_path, capfd):
    with pytest.raises(SystemExit, match="the process of older ended before it was ready"):
        contestants.ours(scene.message(), "older", tmp_path)
    assert f"not in {tmp_path}" in capfd.readouterr().err
