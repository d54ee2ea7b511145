"""Detection of unloaded contacts from torques and motion."""

import numpy as np
import pytest

from wbc_controller.estimation.contact_detection import ContactForces
from wbc_controller.simulation.faults.fault import LONGEST
from wbc_controller.simulation.faults.world import FloorHole
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

FEET = {"left": np.array([3.0, -2.0, 100.0]), "right": np.array([0.0, 0.0, 80.0, 0.0, 0.0, 0.0])}


@pytest.fixture
def forces():
    return ContactForces({"left": 2, "right": 2}, on=10.0, off=5.0)


def check(forces, count=20, **missed):
    """Update with forces that differ from the prediction."""
    lacking = np.zeros(9)
    lacking[2], lacking[5] = missed.get("left", 0.0), missed.get("right", 0.0)
    for _ in range(count):
        forces.update(FEET, lacking, 0.01)
    return forces.unloaded


def test_a_contact_without_force_is_unloaded(forces):
    assert check(forces) == ()
    assert check(forces, 1, right=-80.0) == ()  # not at once: noise is filtered
    assert check(forces, right=-80.0) == ("right",)
    assert check(forces, right=-73.0) == ("right",)  # between off and on
    assert check(forces, right=-60.0) == ()
    assert check(forces, right=-73.0) == ()


def test_lightly_loaded_and_bilateral_contacts_are_ignored(forces):
    light = {"left": np.array([0.0, 0.0, 4.0]), "grip": np.array([0.0, 0.0, -50.0])}
    for _ in range(20):
        forces.update(light, np.zeros(6), 0.01)
    assert forces.unloaded == ()


def test_inactive_contacts_are_removed(forces):
    assert check(forces, left=-100.0) == ("left",)
    forces.update({"right": FEET["right"]}, np.zeros(6), 0.01)
    assert forces.unloaded == ()
    check(forces, left=-100.0)
    forces.restart()
    assert forces.unloaded == ()


def test_a_foot_without_floor_is_detected():
    changes = {"estimation.base_state": "imu", "mock.sensors": "good", "safety.activation_ramp": 0.1}
    trial = EstimationTrial("g1", changes)
    trial.stand()
    trial.follow([0.4, 0.8], [trial.origin + np.array([0.0, 0.03, -0.02]), trial.origin])
    lifted, said = [], []

    def note():
        lifted.extend(trial.controller.model_error.unloaded_contacts)
        said.extend(each for each in trial.report.refused if "is unloaded" in each)

    trial.run(0.9, note)
    assert lifted == said == []
    contact = next(iter(trial.settings.contacts))
    trial.mock.plan([FloorHole(duration=LONGEST, contact=contact)], since=trial.time)
    trial.run(0.04, note)
    assert set(lifted) == {contact}
    assert contact not in trial.controller.holding
    assert said == [f"contact {contact!r} is unloaded according to the robot's motion: excluded from the base estimate"]
