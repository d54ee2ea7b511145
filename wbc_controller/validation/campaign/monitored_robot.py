"""Robot in lockstep with a monitor of its outputs and of its true fall."""

import math
from collections.abc import Callable
from typing import Any

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.settings import Settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.campaign.monitor import OutputMonitor
from wbc_controller.validation.lockstep import Lockstep

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


class MonitoredRobot(Lockstep):
    """Controller and mock robot, with the attributes `monitor` and `fall`."""

    def __init__(
        self, settings: Settings, *observers: Callable[[CycleReport], None], stamps_lie: bool, **options: Any
    ) -> None:
        """Build a robot on its hoist; `stamps_lie` as for `OutputMonitor`, `options` as for `Lockstep`."""
        model = make_model(settings)
        streams = ("joint_states", "odom") if model.floating_base else ("joint_states",)
        topics = {topic.key: topic for topic in controller_endpoints(settings, model)}
        names = {stream: topics[stream].name for stream in streams if stream in topics}
        self.monitor = OutputMonitor(model, settings, names, stamps_lie=stamps_lie)
        super().__init__(settings, model=model, observers=(self.monitor.cycle, *observers), **options)
        self.mock.sent = self.monitor.sent
        MemoryTransport(self.bus).subscribe(counterpart(topics["effort"]), self.monitor.torques)
        self.fall = TrueFall(model, self.mock.plant)

    def publish_state(self) -> None:
        """See `Lockstep`."""
        self.monitor.now = 1.0e-9 * self.mock.stamp
        super().publish_state()
