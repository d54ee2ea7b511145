"""The true robot of a trial: where its centre of mass is, and whether it lies on the ground."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.simulation.plant import Plant

#: A robot has truly fallen if its base is tilted by more, rad, or is less high above its lowest foot than this share.
_TILT, _HEIGHT = math.radians(75.0), 0.3


class Body:
    """The true robot."""

    def __init__(self, model: RobotModel, plant: Plant) -> None:
        """Keep the robot as it stands now as the measure of a fallen one."""
        self._model, self._plant = model, plant
        self._data = model.pinocchio.createData()
        self._height = self._above_feet()

    def com(self) -> Array:
        """Its centre of mass, (3,) in m; of the model, whatever loads it carries."""
        return np.array(pin.centerOfMass(self._model.pinocchio, self._data, self._plant.state()[0]))

    def fallen(self) -> bool:
        """Whether it lies on the ground."""
        if not self._model.floating_base:
            return False
        x, y = self._plant.state()[0][3:5].tolist()
        upright = 1.0 - 2.0 * (x * x + y * y) >= math.cos(_TILT)
        return not (upright and self._above_feet() >= _HEIGHT * self._height)

    def _above_feet(self) -> float:
        """Height of the base above the lowest contact, m; the ground may have moved."""
        if not (self._model.floating_base and self._plant.contacts):
            return math.inf
        feet = [float(self._plant.foot_placement(name).translation[2]) for name in self._plant.contacts]
        return float(self._plant.state()[0][2]) - min(feet)
