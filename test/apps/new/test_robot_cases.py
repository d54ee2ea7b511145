"""Agreement of `wbc new`, `wbc check`, the mock robot and the demo on unusual robots."""

import numpy as np
import pytest
from audits import audited
from refusals import refusal
from robot_cases import REFUSED, SLIDING, SOLE, STANDING, UNNAMED, arm, biped

import wbc_controller as wbc
from wbc_controller.apps.demo.derived_scenario import derived_scenario
from wbc_controller.apps.demo.run import run_demo
from wbc_controller.apps.new.draft import TITLE
from wbc_controller.controller.build.collision_elements import read_collision_elements
from wbc_controller.controller.build.robot import make_model
from wbc_controller.settings.config import load


@pytest.mark.parametrize("case", REFUSED)
def test_invalid_urdf_is_refused(drafted, case):
    urdf, message = REFUSED[case]
    said = refusal(drafted, urdf)
    assert said.startswith("robot.urdf: ")
    assert message in said
    assert "\n" not in said


@pytest.mark.parametrize("case", [case for case in STANDING if case != "legs on wheels"])  # tested below
def test_robot_stands(draft_of, case):
    settings = draft_of(case).settings
    wbc.check(settings)
    simulation = wbc.Simulation(settings)
    before = simulation.plant.state()[0]
    simulation.run(0.3)
    assert not simulation.plant.fallen
    assert np.abs(simulation.plant.state()[0] - before).max() < 0.02


@pytest.mark.parametrize("case", ["a world link with a floating joint", "six virtual joints"])
def test_virtual_joints_of_a_floating_base_are_no_motors(draft_of, drafted, case):
    settings = draft_of(case).settings
    model = make_model(settings)
    assert (model.floating_base, model.base_link, model.nj, model.nv) == (True, "trunk", 10, 16)
    assert set(settings.contacts) == {"left_foot", "right_foot"}
    plain = drafted(biped()).settings
    assert model.pinocchio == make_model(plain).pinocchio
    assert {**settings.model_dump(), "robot": {}} == {**plain.model_dump(), "robot": {}}


def test_virtual_joints_of_a_floating_base_are_refused_as_motors(drafted):
    draft = drafted(STANDING["six virtual joints"])
    draft.values["robot"]["joints"].append("pitch")
    draft.values["robot"]["posture"].append(0.0)
    for base in ("floating", "fixed"):
        draft.values["robot"]["base"] = base
        assert "robot.joints: pitch are virtual joints of a floating base" in refusal(make_model, draft.settings)


def test_feet_corners_and_margins_of_unusual_robots(draft_of, drafted):
    types = {name: contact.type for name, contact in draft_of("legs below a waist").settings.contacts.items()}
    assert types == {"left_foot": "surface", "right_foot": "surface"}
    draft = draft_of("a sole with a corner on an edge")
    corners = np.array(draft.values["contacts"]["left_foot"]["vertices"])
    assert sorted(corners.tolist()) == [[-0.1, -0.045], [-0.1, 0.045], [0.068, 0.045], [0.1, -0.045]]
    draft = draft_of("fingers that slide")
    assert draft.values["limits"] == {"position_margin": 0.002}
    assert "limits" not in drafted(arm()).values


def test_visuals_have_no_effect(drafted):
    """Only shapes of links without collision shapes are read, for the draft and the mechanism."""
    plain = drafted(biped())
    for visual in (UNNAMED, "<visual/>", "<visual><geometry><mesh filename='none.dae'/></geometry></visual>"):
        draft = drafted(biped(sole=visual + SOLE + visual))
        assert draft.values == plain.values
        assert len(read_collision_elements(make_model(draft.settings), make_model(draft.settings).urdf, "")) == 3


def test_joints_without_effort_beside_motors_are_reported(drafted):
    """A spring in the shank with an effort of 0, as in URDFs of robots with series springs."""
    effort = 'effort="100" velocity="10"'
    start = biped().index('name="left_ankle_pitch"')
    draft = drafted(biped()[:start] + biped()[start:].replace(effort, effort.replace("100", "0"), 1))
    assert any("left_ankle_pitch have no effort in the URDF, unlike" in line for line in draft.open_points)
    found = {finding.subject: finding.text for finding in wbc.check(draft.settings)}
    assert found["no motor?"].startswith("left_ankle_pitch: effort 0 in the URDF")
    all_idle = drafted(biped().replace(effort, effort.replace("100", "0")))
    assert not any("belong in `passive_joints`" in line for line in all_idle.open_points)
    assert "no motor?" not in {finding.subject for finding in wbc.check(all_idle.settings)}


def test_keys_and_contacts_have_valid_names(drafted, tmp_path):
    """Names with a dot, which nests parameters, and with special characters of YAML."""
    urdf = arm(SLIDING).replace('"j2"', '"left.j2"').replace('"j3"', '"no: {}#"').replace('effort="50"', "")
    draft = drafted(urdf)
    assert {"left.j2", "no: {}#"} < set(draft.values["robot"]["joint_limits"])
    (tmp_path / "robot.yaml").write_text(draft.to_yaml(TITLE), encoding="utf-8")
    assert load(tmp_path / "robot.yaml").settings == draft.settings
    urdf = biped().replace('"left_foot"', '"a-b"').replace('"right_foot"', '"a_b"')
    assert set(drafted(urdf).values["contacts"]) == {"a_b", "a_b_"}


def test_demo_motions_are_feasible_in_the_check(draft_of):
    settings = draft_of("ankles with a small range").settings
    found = {finding.subject: finding.text for finding in wbc.check(settings)}
    scenario = derived_scenario(settings, make_model(settings))
    moves = {move.name: np.abs(move.points[0][1]).max() for move in scenario.moves}
    assert 0.0 < 1e3 * moves["squat"] < float(found["squat"].split(" mm")[0])
    assert moves["sway"] == pytest.approx(0.03, abs=0.01)


def test_demo_of_an_arm(draft_of, tmp_path, shorten_demos, capsys):
    settings = draft_of("fingers that turn").settings
    model = make_model(settings)
    scenario = derived_scenario(settings, model)
    (reach,) = scenario.reaches
    assert (reach.task, settings.tasks["l3"].frame, scenario.com, scenario.moves) == ("l3", "l3", "", ())
    assert 0.01 < np.linalg.norm(reach.offset) <= 0.1 + 1e-9
    assert {shove.frame for shove in scenario.shoves} == {"l3"}
    assert all(0.01 < np.linalg.norm(shove.impulse) < 0.3 * model.mass for shove in scenario.shoves)
    without = settings.model_copy(update={"tasks": {"l3": settings.tasks["l3"]}})
    assert "a fixed base requires an enabled posture task" in refusal(derived_scenario, without, model)
    without = settings.model_copy(update={"tasks": {"posture": settings.tasks["posture"]}})
    scenario = derived_scenario(without, model)
    assert scenario.reaches == ()
    assert {shove.frame for shove in scenario.shoves} == {"g2"}  # the last joint
    shorten_demos("reach", "shove left")
    path = tmp_path / "arm.yaml"
    path.write_text(draft_of("fingers that turn").to_yaml(TITLE), encoding="utf-8")
    assert run_demo(str(path), tmp_path, lockstep=True)
    printed = capsys.readouterr().out
    assert f"{model.nj} joints, {model.mass:.1f} kg; fixed base" in printed
    found = [word in printed for word in ("reach: l3 error", "shove left", "let go", "vertical")]
    assert found == [True, True, False, False]
    assert (tmp_path / "arm.html").stat().st_size > 100_000


def test_audit_without_warning_on_leaning_wheels(draft_of):
    """The edges of a tread would support a leaning wheel 25 mm beside its contact."""
    settings = draft_of("legs on wheels").settings
    wbc.check(settings)
    assert {contact.type for contact in settings.contacts.values()} == {"rolling"}
    simulation = wbc.Simulation(settings)
    controller = simulation.controller
    controller.set("com", np.array(controller.dynamics.com) + [0.0, 0.03, 0.0], duration=0.5)
    reports = [report for report in audited(simulation, 1.0) if report is not None]
    assert not simulation.plant.fallen
    assert len(reports) > 400
    assert not [warning for report in reports for warning in report.warnings]
    weight = controller.model.mass * controller.model.gravity
    assert max(np.linalg.norm(report.force) for report in reports) < 1.0e-3 * weight
