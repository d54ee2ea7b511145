"""Every kind of contact from its YAML to its forces: what docs/contacts.md shows runs, is made and broken by topic."""

import re

import numpy as np
import pytest
import yaml
from pages import ROOT, page, snippets

from wbc_controller.controller.check.preflight import check
from wbc_controller.settings.contacts import ContactSettings
from wbc_controller.settings.files import types_of

PAGE = page("contacts")
BLOCKS = snippets(PAGE)
SHOWN = {name: contact for block in BLOCKS for name, contact in block.get("contacts", {}).items()}
LOOPS = {name: loop for block in BLOCKS for name, loop in block.get("loops", {}).items()}
UPDATES = re.findall(r"`(\{contacts: \{.*?\}\}\})`", PAGE)
G1 = {"left_foot": "left_ankle_roll_link", "right_foot": "right_ankle_roll_link"}
GO2 = {"front_left_foot": "FL_foot", "front_right_foot": "FR_foot", "rear_left_foot": "RL_foot"}


def test_the_page_has_a_section_and_an_example_for_each_kind():
    headings = " ".join(re.findall(r"^## (.*)$", PAGE, re.MULTILINE))
    for kind in types_of(ContactSettings):
        assert f"`{kind}`" in headings
    assert {contact["type"] for contact in SHOWN.values()} == set(types_of(ContactSettings))
    assert LOOPS
    examples = re.findall(r"`(examples/\w+\.py)`", PAGE)
    assert len(set(examples)) == 5
    assert all((ROOT / example).is_file() for example in examples)


@pytest.mark.parametrize("name", SHOWN)
def test_what_the_page_shows_is_made_borne_and_broken_by_topic(bench, make, name):
    shipped, feet = ("go2", GO2) if SHOWN[name]["frame"] in GO2.values() else ("g1", G1)
    replaced = {foot: {"enabled": False} for foot, frame in feet.items() if frame == SHOWN[name]["frame"]}
    robot = bench(shipped, {"contacts": replaced | {name: SHOWN[name]}})
    contact = robot.loop.controller.qp.contacts[name]
    assert robot.activate().solution is not None
    robot.send("contact_enable", make.bool(True), name)
    report = robot.cycle(150)
    assert not any(report.refused for report in robot.reports)
    assert not report.solution.relaxed
    force = report.solution.forces[name]
    lower, upper = contact.bounds(1.0)
    assert (force >= lower - 1e-6).all()
    assert (force <= upper + 1e-6).all()
    assert (contact.cone @ force).max(initial=0.0) < 1e-4
    sent = robot.received("contact_wrench", name)[-1]
    wrench = [getattr(getattr(sent.wrench, part), axis) for part in ("force", "torque") for axis in "xyz"]
    np.testing.assert_allclose(wrench, contact.basis @ force)
    pushing_on_the_world = SHOWN[name]["type"] in ("point", "rolling") and "against" not in SHOWN[name]
    assert sent.header.frame_id == ("world" if pushing_on_the_world else SHOWN[name]["frame"])
    robot.send("contact_enable", make.bool(False), name)
    most = []
    for _ in range(round(1.2 * robot.settings.contacts[name].ramp / robot.period)):
        forces = robot.cycle().solution.forces
        if name in forces:
            most.append(np.abs(forces[name]).max())
    assert name not in forces
    assert most[-1] <= 0.02 * (SHOWN[name].get("max_normal_force") or SHOWN[name]["max_force"])


def test_a_force_is_asked_of_a_grip_in_the_axes_in_which_it_is_published(bench, make):
    task = {"type": "contact_wrench", "contact": "grip", "weight": 1.0, "setpoint_duration": 0.05}
    grip = SHOWN["grip"] | {"enabled": True, "rpy": [0.4, -0.3, 0.2], "mask": [True, False, True, False, True, False]}
    robot = bench("g1", {"contacts": {"grip": grip}, "tasks": {"pull": task | {"mask": [True] * 5 + [False]}}})
    robot.activate()
    wanted = [10.0, 0.0, -20.0, 0.0, 2.0, 0.0]
    robot.send("setpoint", make.wrench(wanted, "left_rubber_hand"), "pull")
    report = robot.cycle(100)
    assert not any(report.refused for report in robot.reports)
    np.testing.assert_allclose(report.solution.forces["grip"], [10.0, -20.0, 2.0], atol=0.1)
    robot.send("setpoint", make.wrench(wanted, "world"), "pull")
    assert any("left_rubber_hand" in sentence for sentence in robot.cycle().refused)


@pytest.mark.parametrize("text", UPDATES)
def test_the_updates_of_the_page_are_taken(bench, make, text):
    robot = bench("g1", {"contacts": {"grip": SHOWN["grip"]}})
    robot.activate()
    robot.send("update", make.string(text))
    assert not robot.cycle(2).refused
    for name, change in yaml.safe_load(text)["contacts"].items():
        assert (robot.loop.controller.board.sample(robot.clock.time + 1.0).contacts[name] > 0.0) == change["enabled"]


def test_the_loop_of_the_page_is_closed_and_stays_so(bench, robot_of, changed):
    settings, _ = robot_of("g1")
    findings = {finding.subject: finding.text for finding in check(changed(settings, {"loops": LOOPS}))}
    assert findings["loops"] == "bar: closed in the posture"
    robot = bench("g1", {"loops": LOOPS})
    robot.activate()
    report = robot.cycle(20)
    assert report.solution.forces["bar"].shape == (3,)
    assert report.solution.residuals["contact_motion"] < 1e-8
    assert not report.solution.relaxed
