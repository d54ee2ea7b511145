"""Base classes of faults, and their injection into the mock robot."""

import bisect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from wbc_controller.errors import InputRefused, require_known
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.values import Section
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import Measurement

LONGEST = 3600.0  # largest start and duration, s
MOST = 1000  # largest number of planned and active faults
_SAME = 1e-9  # resolution of times, s


class QueuedMessage(NamedTuple):
    """Message in transit."""

    due: float  # simulated delivery time, s
    true_time: int  # simulated time of the content, ns
    payload: bytes


@dataclass(slots=True)
class Effect:
    """Effect of a fault."""

    measured: Callable[[Measurement], None] = lambda measured: None  # changes a measurement
    posted: dict[str, Callable[[QueuedMessage], list[QueuedMessage]]] = field(default_factory=dict)  # by stream
    torques: Callable[[Array], Array] = lambda tau: tau  # changes commanded torques, (na,) in N·m
    each_period: Callable[[], None] = lambda: None  # before the physics
    ended: Callable[[], bool | None] = lambda: True  # at the end, and again while it returns False


@dataclass(frozen=True)
class FaultContext:
    """Robot, time, random choices and stored values of a fault."""

    robot: RobotModel
    plant: Plant
    period: float  # control period, s
    began: float  # simulated, s
    end: float  # simulated, s
    rng: np.random.Generator
    memory: dict[str, Any] = field(default_factory=dict)  # values from the start, or from the last measurement

    @property
    def elapsed(self) -> float:
        """Time since the start, s."""
        return self.plant.time - self.began

    def index_of(self, name: str, names: tuple[str, ...]) -> int:
        """Return the index of a name; random for an empty name."""
        return names.index(name) if name else int(self.rng.integers(len(names)))

    @cached_property
    def direction(self) -> Array:
        """Random horizontal direction, (3,)."""
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    @cached_property
    def sign(self) -> float:
        """Random sign."""
        return float(self.rng.choice([-1.0, 1.0]))

    def ramp_share(self, ramp: float) -> float:
        """Return the present share of a value that grows within `ramp`, s."""
        return min(1.0, self.elapsed / ramp) if ramp > 0.0 else 1.0

    def low_pass(self, key: str, value: Array, time_constant: float) -> Array:
        """Filter a value by a first-order low-pass; its outputs are stored by key."""
        keep = float(np.exp(-self.period / time_constant))
        self.memory[key] = keep * self.memory.get(key, value) + (1.0 - keep) * value
        return np.array(self.memory[key])


class Fault(Section):
    """Parameters of a fault; each kind is a subclass, named in messages like ``joint_noise``.

    A kind overrides `begin`, or for each measurement or command `_distort` or `_change`, with the result of `_start`.
    """

    place: ClassVar[str] = ""  # affected part of the robot, a heading of docs/faults.md

    start: float = Field(0.0, ge=0.0, le=LONGEST, description="delay of the start", json_schema_extra={"unit": "s"})
    duration: float = Field(1.0, gt=0.0, le=LONGEST, description="duration", json_schema_extra={"unit": "s"})
    seed: int = Field(0, ge=0, lt=2**63, description="seed of the random numbers")

    @classmethod
    def kind(cls) -> str:
        """Return the name in messages and files."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """Check the names of joint, actuator, contact and link; raises InputRefused."""
        names = {"joint": robot.joints, "actuator": robot.actuators, "contact": contacts, "link": robot.moving_links}
        for kind in names.keys() & type(self).model_fields.keys():
            require_known(getattr(self, kind) or (), names[kind], f"unknown {kind}", error=InputRefused)

    def begin(self, context: FaultContext) -> Effect:
        """Start the fault and return its effect."""
        state = self._start(context)
        return Effect(
            measured=lambda measured: self._distort(measured, context, state),
            torques=lambda tau: self._change(tau, context, state),
        )

    def _start(self, context: FaultContext) -> Any:
        return None

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        pass

    def _change(self, tau: Array, context: FaultContext, state: Any) -> Array:
        return tau

    def _streams(self, default: str) -> tuple[str, ...]:
        stream = getattr(self, "stream", default)
        return ("joint_states", "odom") if stream == "both" else (stream,)


class JointFault(Fault):
    """Fault of one joint."""

    joint: str = Field("", description="name of the joint; random if empty")

    def _start(self, context: FaultContext) -> Any:
        return context.index_of(self.joint, context.robot.joints)


def number(default: float, low: float, high: float, unit: str, meaning: str) -> Any:
    """Define a parameter with its range, also for campaigns."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def restoring(*parts: tuple[Array, Any]) -> Effect:
    """Return an effect that restores parts of arrays, (array, index), at its end."""
    before = [(array, index, array[index].copy()) for array, index in parts]

    def end() -> None:
        for array, index, values in before:
            array[index] = values

    return Effect(ended=end)


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
