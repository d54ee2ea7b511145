"""Injection of faults into the mock robot: which of them act now, and on what."""

import heapq
import itertools
from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, Parcel, Site
from wbc_controller.simulation.measurement import Measurement
from wbc_controller.simulation.plant import Plant

#: Faults that may be planned at once.
MOST = 1000
#: Times closer than this are the same, s.
_SAME = 1e-9


class Injector:
    """Plans faults, and applies those that act: to what is measured, to messages on their way, to torques.

    Attributes:
        busy: True if a fault is planned or acts, or a message waits; otherwise the injector can be bypassed.
    """

    def __init__(self, robot: RobotModel, plant: Plant, period: float) -> None:
        self.busy = False
        self._robot = robot
        self._plant = plant
        self._period = period
        self._planned: list[tuple[float, Fault]] = []
        self._acting: list[tuple[float, Effect]] = []  # with their ends
        self._waiting: dict[str, list[tuple[float, int, Parcel]]] = {}  # heaps, by stream
        self._count = itertools.count()  # messages that are due at once keep their order

    def plan(self, faults: Sequence[Fault], since: float) -> None:
        """Plan faults, all or none; `since` is the simulated time from which their starts count, s.

        Raises:
            InputRefused: if a parameter does not fit the robot, or too many faults are planned.
        """
        if len(self._planned) + len(self._acting) + len(faults) > MOST:
            raise InputRefused(f"{len(faults)} faults beside those that are planned are too many; at most {MOST}")
        for fault in faults:
            fault.check(self._robot, tuple(self._plant.contacts))
        self._planned += [(since + fault.start, fault) for fault in faults]
        self.busy = self.busy or bool(self._planned)

    def clear(self) -> None:
        """End all faults; messages in transit are lost."""
        self._planned, self._waiting = [], {}
        self._acting = [(-np.inf, effect) for _, effect in self._acting]
        self.pass_time()

    def pass_time(self) -> None:
        """Begin and end what is due at the present time of the plant; called once per period."""
        now, changed = self._plant.time + _SAME, False
        still = []
        for end, effect in self._acting:
            if end <= now and effect.ended() is not False:
                changed = True
            else:
                still.append((end, effect))
        self._acting = still
        for begin, fault in [entry for entry in self._planned if entry[0] <= now]:
            end = begin + fault.duration
            rng = np.random.default_rng(fault.seed)
            site = Site(self._robot, self._plant, self._period, self._plant.time, end, rng)
            self._acting.append((end, fault.begin(site)))
            changed = True
        self._planned = [entry for entry in self._planned if entry[0] > now]
        for _, effect in self._acting:
            if effect.each_period is not None:
                effect.each_period()
        if changed:
            self._plant.forward()  # the physics may have other parameters
        self.busy = bool(self._planned or self._acting or any(self._waiting.values()))

    def spoil(self, measured: Measurement) -> None:
        """Let the faults of the sensors and stamps act on a measurement."""
        for _, effect in self._acting:
            if effect.measured is not None:
                effect.measured(measured)

    def post(self, stream: str, taken: int, payload: bytes | None) -> list[Parcel]:
        """Post a message of a stream, and return the messages that arrive now.

        Args:
            taken: simulated time of the message's content, ns.
            payload: the message; None without a new one.
        """
        now = self._plant.time
        parcels = [Parcel(now, taken, payload)] if payload is not None else []
        for _, effect in self._acting:
            act = (effect.posted or {}).get(stream)
            if act is not None:
                parcels = [changed for parcel in parcels for changed in act(parcel)]
        waiting = self._waiting.setdefault(stream, [])
        for parcel in parcels:
            heapq.heappush(waiting, (parcel.due, next(self._count), parcel))
        arrived = []
        while waiting and waiting[0][0] <= now + _SAME:
            arrived.append(heapq.heappop(waiting)[2])
        return arrived

    def torques(self, tau: Array) -> Array:
        """Let the faults of the actuators act on the commanded torques, (na,) in N·m."""
        for _, effect in self._acting:
            if effect.torques is not None:
                tau = effect.torques(tau)
        return tau
