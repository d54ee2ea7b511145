"""Identification from a recording, against the mock robot of the recording."""

import numpy as np
import pinocchio as pin
import pytest
import yaml
from refusals import refusal

from wbc_controller import Simulation
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.recording.identification import Equations, fit, fit_cycles, identify, report, select_samples
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.fault import FaultContext
from wbc_controller.simulation.faults.world import MassError

HEAVIER, DRY, VISCOUS, SECONDS = 0.15, 0.8, 0.3, 6


#: Largest commanded changes of the orientations about x, y and z, rad.
TURNS = {"base": [0.25, 0.15, 0.2], "pelvis": [0.1, 0.1, 0.2], "torso": [0.15, 0.15, 0.3]}


def moved(robot, heavier, seconds, **friction):
    """Record a swaying robot with more mass and friction than its model."""
    simulation = Simulation(load(robot).replace({f"mock.{key}": of for key, of in friction.items()}), preflight=False)
    controller = simulation.controller
    rng, rows = np.random.default_rng(0), []
    context = FaultContext(controller.model, simulation.plant, controller.period, began=0.0, end=np.inf, rng=rng)
    MassError(share=heavier).begin(context)

    def record(_):
        r = simulation.result
        if r.command is not None:
            found = r.solution.forces if r.solution is not None else {}
            none = {name: np.full(contact.size, np.nan) for name, contact in controller.contacts.items()}
            forces = {f"force/{name}": found.get(name, none[name]) for name in none}
            cycle = {"stamp": r.command.stamp, "mode": r.mode.value, "tau": r.command.tau, "q": r.state.q}
            rows.append({**cycle, "v": r.state.v, **forces})

    origin = controller.dynamics.com.copy()
    for _ in range(seconds * 3):
        controller.set("com", origin + rng.uniform(-1.0, 1.0, 3) * [0.04, 0.04, 0.03] - [0.0, 0.0, 0.03], duration=0.3)
        for task in (task for task in TURNS if task in controller.tasks):
            turn = pin.exp3(rng.uniform(-1.0, 1.0, 3) * TURNS[task])
            controller.set(task, pin.Quaternion(turn).coeffs(), duration=0.3)
        simulation.run(0.3, record)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.fixture(scope="module")
def recording():
    return moved("go2", HEAVIER, SECONDS, joint_friction=DRY, joint_viscosity=VISCOUS)


def assert_honest(found, mass, dry=DRY, viscous=VISCOUS):
    """The errors of all values agree with their standard errors."""
    true = {"mass": mass, "armature": 0.01, "dry": dry, "viscous": viscous}
    for kind, value in true.items():
        own = [i for i, name in enumerate(found.names) if name.partition(" ")[0] == kind]
        errors = (found.values[own] - value) / found.errors[own]
        print(f"{kind}: errors of {np.sqrt(np.mean(errors**2)):.2f} σ RMS, at most {np.abs(errors).max():.2f} σ")
        assert np.abs(errors).max() < 3.0, kind
        assert len(own) < 5 or np.sqrt(np.mean(errors**2)) < 1.3, kind


def test_masses_and_frictions_of_the_mock_robot_are_found_within_5_percent(recording):
    found, model = fit_cycles(load("go2").settings, recording)
    text = report(found, model)
    print(text)
    values = dict(zip(found.names, found.values, strict=True))
    told = {name for i, name in enumerate(found.names) if found.determined(i)}
    assert {"mass base", *(f"dry {joint}" for joint in model.joints if "hip" not in joint)} <= told
    assert values["mass base"] == pytest.approx(1.0 + HEAVIER, rel=0.05)
    # The hips turn slowly and alike: their sum is determined, and each of them within its standard error.
    hips = [values[f"dry {joint}"] for joint in model.joints if "hip" in joint]
    assert np.mean(hips) == pytest.approx(DRY, rel=0.05)
    for name in told:
        true = {"mass": 1.0 + HEAVIER, "armature": 0.01, "dry": DRY, "viscous": VISCOUS}[name.partition(" ")[0]]
        assert values[name] == pytest.approx(true, rel=0.05), name
    assert_honest(found, 1.0 + HEAVIER)
    friction = yaml.safe_load(text[text.index("robot:") :])["robot"]["friction"]
    assert friction["FL_calf_joint"]["dry"] == pytest.approx(DRY, rel=0.05)
    load("go2").replace({"robot.friction": friction})  # usable


def test_the_errors_of_a_humanoid_with_heavier_links_are_within_their_standard_errors():
    found, _ = fit_cycles(load("g1").settings, moved("g1", 0.1, 5))
    assert_honest(found, 1.1, 0.0, 0.0)
    values = dict(zip(found.names, found.values, strict=True))
    assert values["mass torso_link"] == pytest.approx(1.1, abs=0.05)


def test_undetermined_values_stay_nominal_and_none_is_negative():
    rng = np.random.default_rng(0)
    A = np.zeros((200, 3))
    A[:, 1:] = rng.normal(size=(200, 2))
    b = A @ [0.0, 2.0, -0.5] + 0.01 * rng.normal(size=200)
    names = ("mass unseen", "dry knee", "viscous knee")
    system = Equations(A, b, names, np.array([1.0, 0.0, 0.0]), np.arange(200) // 10)
    found = fit(system, system)
    assert found.values[0] == pytest.approx(1.0)
    assert found.values[2] == pytest.approx(0.0, abs=1e-6)
    assert [found.determined(i) for i in range(3)] == [False, True, False]


def test_no_moment_spans_a_change_of_contacts_or_a_gap(recording):
    settings = load("go2").settings
    model = make_model(settings)
    contacts = make_qp(settings, model).contacts
    columns = {name: values[:300].copy() for name, values in recording.items()}
    columns[f"force/{next(iter(contacts))}"][100:] = np.nan
    columns["stamp"][200:] += 50_000_000
    seen = select_samples(columns, model, contacts)
    places = [int(np.flatnonzero((columns["q"] == q).all(axis=1))[0]) for q in seen.q]
    assert {len(held) for place, held in zip(places, seen.contacts, strict=True) if place < 100} == {4}
    assert {len(held) for place, held in zip(places, seen.contacts, strict=True) if place > 100} == {3}
    half = round(0.5 * 0.03 / 0.002) - 1
    for change in (100, 200):
        assert min(place for place in places if place > change) >= change + half
        assert max(place for place in places if place < change) < change - half
    assert len(places) > 10


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda columns: columns.pop("q"), "missing in the recording: q"),
        (lambda columns: columns.update(tau=np.zeros((9, 3))), "tau has (3,) values per cycle; this robot has 12"),
        (lambda columns: columns["mode"].__setitem__(slice(None), "damping"), "has regular states, an active"),
    ],
)
def test_an_unusable_recording_is_refused_with_the_reason(recording, change, said):
    columns = {name: values[:200].copy() for name, values in recording.items()}
    change(columns)
    assert said in refusal(fit_cycles, load("go2").settings, columns)


def test_a_file_that_is_no_recording_is_refused(tmp_path):
    (tmp_path / "text.mcap").write_text("nothing")
    for name in ("text.mcap", "none.mcap"):
        assert f"recording {tmp_path / name}: " in refusal(identify, load("go2").settings, tmp_path / name)


def test_a_file_of_the_flight_recorder_is_read(record, tmp_path):
    run = record(tmp_path / "run.mcap")
    run.stand(200)
    run.recorder.close()
    said = refusal(identify, load("go2").settings, run.file)
    assert "run.mcap: the recording contains no motion that its contacts permit" in said
