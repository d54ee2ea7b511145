"""Shipped robots and a standing controller."""

from collections.abc import Callable

import numpy as np
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.problems import rest


@pytest.fixture(scope="session")
def standing():
    """Make a controller: gravity compensation with a spring and damper at each joint."""

    def make(model: RobotModel, settings: Settings, q: np.ndarray) -> Callable[[Plant], np.ndarray]:
        qp, state = make_qp(settings, model), RobotState(0, frozen(q), frozen(np.zeros(model.nv)))
        tau = qp.solve(state, rest(qp, settings, state)).tau
        inertia = qp.dynamics.M.diagonal()[model.v_index]
        parts = ("leg", "hip", "thigh", "calf", "knee", "ankle")
        legs = np.array([any(part in name for part in parts) for name in model.joints])
        stiff = max(20.0 * model.mass, 60.0) if model.na > 12 else 60.0
        stiffness = np.where(legs, stiff, np.minimum(900.0 * inertia, 3000.0))
        damping = np.where(legs, 0.01 * stiffness, 1.4 * np.sqrt(stiffness * inertia))

        def control(plant: Plant) -> np.ndarray:
            q, v = plant.state()
            return tau + stiffness * (model.posture - q[model.q_index]) - damping * v[model.v_index]

        return control

    return make


@pytest.fixture(scope="session")
def load(robot_of):
    """Model and settings of a shipped robot, by name; built once."""
    return lambda name: robot_of(name)[::-1]


@pytest.fixture
def go2(load) -> tuple[RobotModel, Settings]:
    return load("go2")
