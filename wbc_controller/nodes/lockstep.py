"""Controller, mock robot and user on one thread and simulated time."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock, SimulatedClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.user import User
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.simulation.mock_robot import MockRobot


class Lockstep:
    """Controller, mock robot and user on one memory bus."""

    def __init__(
        self,
        settings: Settings,
        *,
        model: RobotModel | None = None,
        bus: MemoryBus | None = None,
        use_sim_time: bool = False,
        mock: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        """Build a robot on its hoist; `mock` and `options` are options of `MockRobot` and `make_loop`."""
        self.settings = settings
        self.model = make_model(settings) if model is None else model
        self.topics = controller_endpoints(settings, self.model)
        self.bus = MemoryBus() if bus is None else bus
        mock_options = {"model": self.model, "settings": settings, **(mock or {})}
        self.mock = MockRobot(transport=MemoryTransport(self.bus), **mock_options)
        self.controller = Controller(settings, preflight=False, model=self.model)
        transport = MemoryTransport(self.bus)
        self._manual = ManualClock()
        self.clock = SimulatedClock(self.topics, transport) if use_sim_time else self._manual
        self.loop = make_loop(self.controller, transport, self.clock, self.topics, **options)
        self._data = self.model.pinocchio.createData()

    @cached_property
    def user(self) -> User:
        """User of the robot; its topics open at the first use."""
        return User(self.settings, self.model, self.topics, MemoryTransport(self.bus))

    def com(self) -> Array:
        """Return the true centre of mass without payloads, (3,) in m."""
        return np.array(pin.centerOfMass(self.model.pinocchio, self._data, self.mock.plant.state()[0]))

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.mock.plant.time

    def publish_state(self) -> None:
        """Publish the robot's state, and set the clock to its stamp."""
        self._manual.time = 1.0e-9 * self.mock.stamp
        self.mock.publish()

    def cycle(self) -> CycleReport:
        """Execute one control period."""
        self.publish_state()
        report = self.loop.cycle()
        self.mock.advance()
        return report
