"""Contacts that carry nothing are found by torques and motion, and no others are."""

from __future__ import annotations

import numpy as np
import pytest

from wbc_controller.estimation.contact_forces import ContactForces
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.fault import LONGEST
from wbc_controller.simulation.faults.world import FloorHole
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

FEET = {"left": np.array([3.0, -2.0, 100.0]), "right": np.array([0.0, 0.0, 80.0, 0.0, 0.0, 0.0])}


@pytest.fixture
def forces():
    return ContactForces({"left": 2, "right": 2}, on=10.0, off=5.0)


def look(forces, count=20, **missed):
    """For a while, with forces that are this much off what was predicted."""
    lacking = np.zeros(9)
    lacking[2], lacking[5] = missed.get("left", 0.0), missed.get("right", 0.0)
    for _ in range(count):
        forces.update(FEET, lacking, 0.01)
    return forces.unloaded


def test_a_contact_without_its_force_is_lifted_until_it_has_some(forces):
    assert look(forces) == ()
    assert look(forces, 1, right=-80.0) == ()  # not at once: noise is filtered
    assert look(forces, right=-80.0) == ("right",)
    assert look(forces, right=-73.0) == ("right",)  # between off and on
    assert look(forces, right=-60.0) == ()
    assert look(forces, right=-73.0) == ()


def test_one_that_should_carry_little_and_one_that_can_pull_are_none_of_its_business(forces):
    light = {"left": np.array([0.0, 0.0, 4.0]), "grip": np.array([0.0, 0.0, -50.0])}
    for _ in range(20):
        forces.update(light, np.zeros(6), 0.01)
    assert forces.unloaded == ()


def test_one_that_is_switched_off_is_forgotten(forces):
    assert look(forces, left=-100.0) == ("left",)
    forces.update({"right": FEET["right"]}, np.zeros(6), 0.01)
    assert forces.unloaded == ()
    look(forces, left=-100.0)
    forces.restart()
    assert forces.unloaded == ()


@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_a_foot_whose_floor_vanishes_is_found_and_said_and_a_sway_lifts_none(robot):
    trial = EstimationTrial(load(robot).replace({"estimation.base_state": "imu", "mock.sensors": "good"}), {})
    trial.stand()
    trial.follow([0.4, 0.8], [trial.origin + np.array([0.0, 0.03, -0.02]), trial.origin])
    lifted, said = [], []

    def note():
        lifted.extend(trial.controller.model_error.unloaded_contacts)
        said.extend(each for each in trial.report.refused if "is unloaded" in each)

    trial.run(1.0, note)
    assert lifted == said == []
    contact = next(iter(trial.settings.contacts))
    trial.mock.plan([FloorHole(duration=LONGEST, contact=contact)], since=trial.time)
    trial.run(0.04, note)
    assert set(lifted) == {contact}
    assert contact not in trial.controller.holding
    assert said == [f"contact {contact!r} is unloaded according to the robot's motion: excluded from the base estimate"]
