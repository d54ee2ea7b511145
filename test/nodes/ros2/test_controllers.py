"""The shipped controllers of ros2_control fit the shipped robots."""

import pytest
import yaml
from pages import ROOT

from wbc_controller.settings.files import load_settings, shipped_configurations

FOLDER = ROOT / "config/ros2_control"


@pytest.mark.parametrize("robot", shipped_configurations())
def test_the_controllers_take_the_torques_in_the_order_of_the_configuration(robot):
    settings = load_settings(shipped_configurations()[robot])
    controllers = yaml.safe_load((FOLDER / f"{robot}.yaml").read_text(encoding="utf-8"))
    manager = controllers["controller_manager"]["ros__parameters"]
    assert controllers["effort_controller"]["ros__parameters"]["joints"] == settings.robot.joints
    assert manager["update_rate"] == settings.control.rate
    assert manager["effort_controller"]["type"] == "effort_controllers/JointGroupEffortController"


def test_they_are_not_taken_for_robots():
    assert len(list(FOLDER.glob("*.yaml"))) == len(shipped_configurations())
