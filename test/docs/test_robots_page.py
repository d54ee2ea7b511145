"""What docs/robots.md shows can be built, and drives the joints as the page says."""

import numpy as np
import pytest
from chains import joint, link, menagerie, robot
from pages import page, snippets

from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.urdf import UNLIMITED

TRANSMISSION, LIMITS, PASSIVE, LOCKED = snippets(page("robots"))
LEG = robot(
    link("pelvis"), link("thigh"), link("shank"), link("foot"),
    joint("hip", "pelvis", "thigh"), joint("knee", "thigh", "shank"), joint("ankle", "shank", "foot"),
)  # fmt: skip
NOTHING = {"actuators": [], "transmission": {}, "passive_joints": {}, "locked_joints": {}}


@pytest.mark.parametrize(
    ("shown", "ratios"),
    [
        (TRANSMISSION, [[1.0, 0.0, 0.0], [9.0, 9.0, 0.0], [0.0, 0.0, 1.0]]),
        (PASSIVE, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        (LOCKED, np.eye(2)),
    ],
    ids=["transmission", "passive", "locked"],
)
def test_what_the_page_shows_is_what_is_built(shown, ratios):
    model = make_model(menagerie(**NOTHING | shown), LEG)
    np.testing.assert_array_equal(model.actuation.ratios, ratios)
    assert model.joints == tuple(shown["joints"])


def test_the_limits_that_the_page_shows_replace_those_of_the_urdf():
    rover = robot(
        link("body"), link("shank"), link("rim"),
        joint("knee", "body", "shank"), joint("wheel", "shank", "rim", kind="continuous"),
    )  # fmt: skip
    model = make_model(menagerie(**NOTHING | LIMITS, joints=["knee", "wheel"], posture=[0.1, 7.0]), rover)
    np.testing.assert_array_equal(model.effort_limits, [2.7, 5.0])
    np.testing.assert_array_equal(model.velocity_limits, [12.0, 12.0])
    np.testing.assert_array_equal(model.position_upper, [2.0, UNLIMITED])
    np.testing.assert_array_equal(model.position_lower, [-2.0, -UNLIMITED])
