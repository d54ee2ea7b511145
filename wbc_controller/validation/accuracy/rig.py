"""A robot that has no odometry, on one thread: controller, sensors and physics on simulated time, the truth beside."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import NoSolution
from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.records import Array, Mode
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config, load
from wbc_controller.simulation.faults.fault import Fault
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.validation.campaign.user import User, com_trajectory

#: Time for the torques to ramp in, and to come to rest after the base is let go, beside those of the settings, s.
_RAMPED, _RESTED = 0.2, 1.0
#: Patience with an estimate that does not begin, s.
_PATIENCE = 5.0


class Rig:
    """A mock robot that stands on its estimate, with a user who moves its centre of mass.

    Attributes:
        settings: of the robot.
        controller: the controller.
        robot: the mock robot.
        user: sends requests to the controller.
        faults: what is wrong with the robot beside its sensors, from the time at which its base is let go.
        report: of the last cycle.
        answered: the true q and v of the state that the last cycle has answered; None before the first.
        origin: where the centre of mass should be while it stands, (3,) in m; set by `stand`.
        shift: from the true world to the one of the estimate, (3,) in m, when it had come to stand.
    """

    report: CycleReport

    def __init__(self, robot: str | Config, changes: Mapping[str, Any], *, force_sensors: bool = False) -> None:
        """Build a robot that is still held.

        Args:
            robot: name of a shipped robot, or the path of a file.
            changes: settings to be changed, by dotted key.
            force_sensors: whether the controller hears the true force at each contact.

        Raises:
            ConfigurationError: where the robot cannot be controlled or simulated so.
        """
        config = load(robot).replace({"control.markers_rate": 0.0, **changes})
        self.settings: Settings = config.settings
        model = make_model(self.settings)
        topics = controller_endpoints(self.settings, model)
        bus = MemoryBus()
        self._clock = ManualClock()
        measured = {each.subject: each.name for each in topics if each.key == "measured_wrench" and force_sensors}
        remappings = {f"~/contacts/{contact}/wrench": name for contact, name in measured.items()}
        self.robot = MockRobot(model, self.settings, MemoryTransport(bus), remappings=remappings)
        self.controller = Controller(config, preflight=False, model=model)
        self._loop = make_loop(self.controller, MemoryTransport(bus), self._clock, topics)
        self.user = User(self.settings, model, topics, MemoryTransport(bus))
        self.faults: Sequence[Fault] = ()
        self.answered: tuple[Array, Array] | None = None
        self._data = model.pinocchio.createData()
        self._com = next(iter(self.user.tasks("com")), "")

    @property
    def estimator(self) -> BaseEstimator | None:
        """The estimator of the base, where the settings have one."""
        return self._loop.estimator

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.robot.plant.time

    def com(self) -> Array:
        """The true centre of mass, (3,) in m."""
        return np.array(pin.centerOfMass(self.controller.model.pinocchio, self._data, self.robot.plant.state()[0]))

    def cycle(self) -> None:
        """Let one control period pass."""
        self._clock.time = 1.0e-9 * self.robot.stamp
        self.answered = self.robot.plant.state()
        self.robot.publish()
        self.report = self._loop.cycle()
        self.robot.advance()

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """Let time pass.

        Args:
            seconds: how long.
            each: called after every cycle.

        Raises:
            NoSolution: where the controller has left its active mode, or the robot has fallen.
        """
        for _ in range(round(seconds * self.settings.control.rate)):
            self.cycle()
            if self.report.mode is not Mode.ACTIVE or self.robot.plant.fallen:
                fault = self.report.fault
                why = f"{fault.code}: {fault.sentence}" if fault is not None else "the robot fell"
                raise NoSolution(why, self.report.mode.value, None)
            each()

    def settle(self) -> None:
        """Wait for the estimate, with the base held."""
        settled = 0.0 if self.estimator is None else self.settings.estimation.settling
        for _ in range(math.ceil((settled + 0.05) * self.settings.control.rate)):
            self.cycle()

    def stand(self) -> None:
        """Wait for the estimate, activate, and let the base go.

        Raises:
            NoSolution: where that does not succeed.
        """
        self.settle()
        deadline = self.time + _PATIENCE
        while self.report.mode is not Mode.ACTIVE:
            self.user.say("command", "activate")
            self.cycle()
            if self.time > deadline:
                raise NoSolution("; ".join(self.report.refused), self.report.mode.value, None)
        self.run(self.settings.safety.activation_ramp + _RAMPED)
        self.robot.plan(self.faults, since=self.time)
        self.robot.plant.hold(False)
        self.run(_RESTED)
        self.origin = self.wanted()
        base = None if self.estimator is None else self.estimator.base
        true, _ = self.robot.plant.state() if self.answered is None else self.answered
        self.shift = np.zeros(3) if base is None else base[0][:3] - true[:3]

    def wanted(self) -> Array:
        """Where the centre of mass should be now, (3,) in m."""
        return np.array(self.controller.board.present(self._com, 1.0e-9 * self.robot.stamp).position)

    def follow(self, times: Sequence[float], points: Sequence[Array]) -> None:
        """Send the centre of mass along points at rest.

        Args:
            times: of the points, from now on, s.
            points: each (3,) in m, in the frame of the controller's estimate.
        """
        self.user.send("trajectory", com_trajectory(times, np.array(points)), self._com)
