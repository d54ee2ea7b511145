"""Shipped robots and a standing controller."""

import numpy as np
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.problems import rest


class Standing:
    """Gravity compensation with a spring and damper at each joint."""

    def __init__(self, model: RobotModel, settings: Settings, q: np.ndarray) -> None:
        qp, state = make_qp(settings, model), RobotState(0, frozen(q), frozen(np.zeros(model.nv)))
        self.tau = qp.solve(state, rest(qp, settings, state)).tau
        inertia = qp.dynamics.M.diagonal()[model.v_index]
        legs = np.array(
            [any(part in name for part in ("leg", "hip", "thigh", "calf", "knee", "ankle")) for name in model.joints]
        )
        self.stiffness = np.where(
            legs, np.maximum(20.0 * model.mass, 60.0) if model.na > 12 else 60.0, np.minimum(900.0 * inertia, 3000.0)
        )
        self.damping = np.where(legs, 0.01 * self.stiffness, 1.4 * np.sqrt(self.stiffness * inertia))
        self._model = model

    def __call__(self, plant: Plant) -> np.ndarray:
        q, v = plant.state()
        error = self._model.posture - q[self._model.q_index]
        return self.tau + self.stiffness * error - self.damping * v[self._model.v_index]


@pytest.fixture(scope="session")
def load(robot_of):
    """Model and settings of a shipped robot, by name; built once."""
    return lambda name: robot_of(name)[::-1]


@pytest.fixture(scope="session")
def standing():
    """Return the class of the standing controller."""
    return Standing


@pytest.fixture
def go2(load) -> tuple[RobotModel, Settings]:
    return load("go2")
