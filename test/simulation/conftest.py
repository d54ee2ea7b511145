"""Shipped robots and a standing controller."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import SurfaceContact
from wbc_controller.simulation.mechanism import contact_frame
from wbc_controller.simulation.plant import Plant


class Standing:
    """Gravity compensation with a spring and damper at each joint."""

    def __init__(self, model: RobotModel, settings: Settings, q: np.ndarray) -> None:
        data = model.pinocchio.createData()
        pin.computeJointJacobians(model.pinocchio, data, q)
        blocks = []
        for name, contact in settings.contacts.items():
            joint, placement = contact_frame(model, name, contact)
            jacobian = pin.getJointJacobian(model.pinocchio, data, joint, pin.LOCAL)
            jacobian = placement.inverse().action @ jacobian
            rotation = (data.oMi[joint] * placement).rotation
            size = 6 if isinstance(contact, SurfaceContact) else 3
            blocks.append((np.kron(np.eye(2), rotation) @ jacobian)[:size])
        jacobian = np.vstack(blocks)
        gravity = pin.computeGeneralizedGravity(model.pinocchio, data, q)
        forces = np.linalg.lstsq(jacobian[:, :6].T, gravity[:6], rcond=None)[0]
        inertia = pin.crba(model.pinocchio, data, q).diagonal()[model.v_index]
        self.tau = (gravity - jacobian.T @ forces)[model.v_index]
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
