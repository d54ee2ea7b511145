"""Robots that other readers misread: `wbc new`, `wbc check`, the mock robot and the demo agree on them."""

from __future__ import annotations

import numpy as np
import pytest
from robot_cases import EDGED_SOLE, REFUSED, SOLE, STANDING, UNNAMED, arm, biped

import wbc_controller as wbc
from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.controller.build.collision_elements import read_collision_elements
from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError


@pytest.fixture
def drafted(tmp_path):
    """Drafts the configuration of a URDF's text."""

    def make(text, **options):
        (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
        (tmp_path / "sole.obj").write_text(EDGED_SOLE, encoding="utf-8")
        return new_configuration(str(tmp_path / "robot.urdf"), **options)

    return make


@pytest.mark.parametrize("case", REFUSED)
def test_a_urdf_that_is_wrong_is_refused_in_one_sentence(drafted, case):
    urdf, message = REFUSED[case]
    with pytest.raises(ConfigurationError) as error:
        drafted(urdf)
    assert str(error.value).startswith("robot.urdf: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("case", STANDING)
def test_a_robot_that_is_read_stands(drafted, case):
    settings = drafted(STANDING[case]).settings
    wbc.check(settings)
    simulation = wbc.Simulation(settings)
    simulation.run(1.0)
    assert not simulation.plant.fallen


@pytest.mark.parametrize("case", ["a world link with a floating joint", "six virtual joints"])
def test_joints_in_place_of_a_floating_base_are_no_motors(drafted, case):
    settings = drafted(STANDING[case]).settings
    model = make_model(settings)
    assert (model.floating_base, model.base_link, model.nj, model.nv) == (True, "trunk", 10, 16)
    assert set(settings.contacts) == {"left_foot", "right_foot"}


def test_joints_in_place_of_a_floating_base_are_refused_as_motors(drafted):
    draft = drafted(STANDING["six virtual joints"])
    draft.values["robot"]["joints"].append("pitch")
    draft.values["robot"]["posture"].append(0.0)
    for base in ("floating", "fixed"):
        draft.values["robot"]["base"] = base
        with pytest.raises(ConfigurationError, match=r"robot.joints: pitch stand for a floating base in the URDF"):
            make_model(draft.settings)


def test_both_feet_below_a_waist_are_found(drafted):
    contacts = drafted(STANDING["legs below a waist"]).settings.contacts
    assert {name: contact.type for name, contact in contacts.items()} == {
        "left_foot": "surface", "right_foot": "surface",
    }  # fmt: skip


def test_visuals_change_nothing(drafted):
    """Neither the draft nor the mechanism: only the shapes of links without collision shapes are looked at."""
    plain = drafted(biped())
    for visual in (UNNAMED, "<visual/>", "<visual><geometry><mesh filename='none.dae'/></geometry></visual>"):
        draft = drafted(biped(sole=visual + SOLE + visual))
        assert draft.values == plain.values
        assert len(read_collision_elements(make_model(draft.settings), make_model(draft.settings).urdf, "")) == 3


def test_the_margin_fits_the_smallest_range(drafted):
    draft = drafted(STANDING["fingers that slide"])
    assert draft.values["limits"] == {"position_margin": 0.004}
    assert "limits" not in drafted(arm()).values


def test_a_corner_on_an_edge_is_left_out(drafted):
    draft = drafted(STANDING["a sole with a corner on an edge"])
    corners = np.array(draft.values["contacts"]["left_foot"]["vertices"])
    assert sorted(corners.tolist()) == [[-0.1, -0.045], [-0.1, 0.045], [0.068, 0.045], [0.1, -0.045]]
