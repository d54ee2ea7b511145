"""Injection of faults into the mock robot."""

import bisect
from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, FaultContext, QueuedMessage
from wbc_controller.simulation.measurement import Measurement
from wbc_controller.simulation.plant import Plant

MOST = 1000  # largest number of planned and active faults
_SAME = 1e-9  # resolution of times, s


class Injector:
    """Plans faults, and applies active ones to measurements, messages and torques."""

    def __init__(self, robot: RobotModel, plant: Plant, period: float) -> None:
        self._robot = robot
        self._plant = plant
        self._period = period
        self._planned: list[tuple[float, Fault]] = []
        self._acting: list[tuple[float, Effect]] = []  # with end times, s
        self._waiting: dict[str, list[QueuedMessage]] = {}  # by stream, in the order of delivery

    def plan(self, faults: Sequence[Fault], since: float) -> None:
        """Plan all faults, or none (InputRefused), relative to the simulated time `since`, s."""
        if len(self._planned) + len(self._acting) + len(faults) > MOST:
            raise InputRefused(f"{len(faults)} more faults are too many; at most {MOST} may be planned or active")
        for fault in faults:
            fault.check(self._robot, tuple(self._plant.contacts))
        self._planned += [(since + fault.start, fault) for fault in faults]

    def clear(self) -> None:
        """End all faults; queued messages are lost."""
        self._planned, self._waiting = [], {}
        self._acting = [(-np.inf, effect) for _, effect in self._acting]
        self.update()

    def update(self) -> None:
        """Start and end due faults; called once per period."""
        now = self._plant.time + _SAME
        active = [(end, effect) for end, effect in self._acting if end > now or effect.ended() is False]
        due = [entry for entry in self._planned if entry[0] <= now]
        changed = bool(due) or len(active) < len(self._acting)
        self._acting, self._planned = active, [entry for entry in self._planned if entry[0] > now]
        for begin, fault in due:
            end = begin + fault.duration
            rng = np.random.default_rng(fault.seed)
            context = FaultContext(self._robot, self._plant, self._period, self._plant.time, end, rng)
            self._acting.append((end, fault.begin(context)))
        for _, effect in self._acting:
            effect.each_period()
        if changed:
            self._plant.forward()  # changed physics

    def distort(self, measured: Measurement) -> None:
        """Apply sensor and stamp faults to a measurement."""
        for _, effect in self._acting:
            effect.measured(measured)

    def deliver(self, stream: str, taken: int, payload: bytes | None, delay: float = 0.0) -> list[QueuedMessage]:
        """Queue a message of a stream, if any, for a `delay`, s, and return due messages."""
        now = self._plant.time
        queued = [QueuedMessage(now + delay, taken, payload)] if payload is not None else []
        for _, effect in self._acting:
            if stream in effect.posted:
                queued = [changed for message in queued for changed in effect.posted[stream](message)]
        waiting = self._waiting.setdefault(stream, [])
        for message in queued:
            bisect.insort(waiting, message, key=attrgetter("due"))
        count = bisect.bisect(waiting, now + _SAME, key=attrgetter("due"))
        arrived, self._waiting[stream] = waiting[:count], waiting[count:]
        return arrived

    def torques(self, tau: Array) -> Array:
        """Apply actuator faults to commanded torques, (na,) in N·m."""
        for _, effect in self._acting:
            tau = effect.torques(tau)
        return tau
