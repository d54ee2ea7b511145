"""Shipped robots."""

import pytest

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings import Settings


@pytest.fixture(scope="session")
def load(robot_of):
    """Model and settings of a shipped robot, by name; built once."""
    return lambda name: robot_of(name)[::-1]


@pytest.fixture
def go2(load) -> tuple[RobotModel, Settings]:
    return load("go2")
