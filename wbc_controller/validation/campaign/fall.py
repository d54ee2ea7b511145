"""True fall of a robot in a trial."""

import math

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.simulation.plant import Plant

#: Tilt of a fallen base, rad, and its height above the lowest foot as a share of the initial height.
_TILT, _HEIGHT = math.radians(75.0), 0.3


class TrueFall:
    """Detects a fall from the true state."""

    def __init__(self, model: RobotModel, plant: Plant) -> None:
        self._model, self._plant = model, plant
        self._height = self._height_above_feet()

    def has_fallen(self) -> bool:
        """True if the robot lies on the ground."""
        if not self._model.floating_base:
            return False
        x, y = self._plant.state()[0][3:5].tolist()
        upright = 1.0 - 2.0 * (x * x + y * y) >= math.cos(_TILT)
        return not (upright and self._height_above_feet() >= _HEIGHT * self._height)

    def _height_above_feet(self) -> float:
        if not (self._model.floating_base and self._plant.contacts):
            return math.inf
        feet = [float(self._plant.foot_placement(name).translation[2]) for name in self._plant.contacts]
        return float(self._plant.state()[0][2]) - min(feet)
