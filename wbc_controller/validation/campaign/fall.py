"""The true fall of a robot in a trial."""

import math

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.simulation.plant import Plant

#: A robot has fallen if its base is tilted by more, rad, or its height above the lowest foot is a smaller share.
_TILT, _HEIGHT = math.radians(75.0), 0.3


class TrueFall:
    """Compares the robot with its posture at the start."""

    def __init__(self, model: RobotModel, plant: Plant) -> None:
        """Keep the present height of the base."""
        self._model, self._plant = model, plant
        self._height = self._above_feet()

    def seen(self) -> bool:
        """Whether the robot lies on the ground."""
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
