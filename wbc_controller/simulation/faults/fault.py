"""What a fault is: validated parameters, and the effect that they have once it has begun."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings.values import Section
from wbc_controller.simulation.measurement import Measurement
from wbc_controller.simulation.plant import Plant

#: Longest time until a fault starts, and longest duration, s.
LONGEST = 3600.0


class Parcel(NamedTuple):
    """A message on its way.

    Attributes:
        due: simulated time at which it is delivered, s.
        taken: simulated time of what it tells, ns.
        payload: the serialized message.
    """

    due: float
    taken: int
    payload: bytes


@dataclass(slots=True)
class Effect:
    """What a fault does while it lasts.

    Attributes:
        measured: changes what the sensors have measured.
        posted: changes the parcel of one message of a stream into those that are delivered, by stream.
        torques: changes the commanded torques of the actuators, (na,) in N·m.
        each_period: called once per control period, before the physics.
        ended: called at the end; it says whether the effect is over. Until then it is called in each period.
    """

    measured: Callable[[Measurement], None] | None = None
    posted: dict[str, Callable[[Parcel], list[Parcel]]] | None = None
    torques: Callable[[np.ndarray], np.ndarray] | None = None
    each_period: Callable[[], None] | None = None
    ended: Callable[[], bool] = lambda: True


@dataclass(slots=True)
class Site:
    """The robot on which a fault acts, from the fault's beginning on.

    Attributes:
        robot: the robot.
        plant: its physics.
        period: control period, s.
        end: simulated time at which the fault ends, s.
        rng: the fault's own random numbers.
        began: simulated time at which the fault began, s.
    """

    robot: RobotModel
    plant: Plant
    period: float
    end: float
    rng: np.random.Generator
    began: float = field(init=False)

    def __post_init__(self) -> None:
        self.began = self.plant.time

    @property
    def elapsed(self) -> float:
        """Time since the beginning, s."""
        return self.plant.time - self.began

    def grown(self, ramp: float) -> float:
        """Share of a value that grows linearly in a time, s."""
        return min(1.0, self.elapsed / ramp) if ramp > 0.0 else 1.0

    def sign(self) -> float:
        """A random sign."""
        return float(self.rng.choice([-1.0, 1.0]))

    def one_of(self, name: str, names: tuple[str, ...]) -> int:
        """Index of a name, or of one at random where it is empty."""
        return names.index(name) if name else int(self.rng.integers(len(names)))

    def direction(self) -> np.ndarray:
        """A random horizontal direction, (3,)."""
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle), 0.0])


class Fault(Section):
    """Parameters of a fault. Each kind is a subclass; its name in messages is that of the class, as ``joint_noise``."""

    #: Where it acts: a heading of docs/faults.md.
    place: ClassVar[str] = ""

    start: float = Field(0.0, ge=0.0, le=LONGEST, description="time until it begins", json_schema_extra={"unit": "s"})
    duration: float = Field(1.0, gt=0.0, le=LONGEST, description="how long it lasts", json_schema_extra={"unit": "s"})
    seed: int = Field(0, ge=0, lt=2**63, description="of its random numbers")

    @classmethod
    def kind(cls) -> str:
        """Its name in messages and files."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """See that its parameters fit a robot and its contacts, by name.

        Raises:
            InputRefused: where a name is unknown.
        """

    def begin(self, site: Site) -> Effect:
        """Begin to act."""
        raise NotImplementedError


class MeasurementFault(Fault):
    """A fault that changes each measurement."""

    def begin(self, site: Site) -> Effect:
        """Change each measurement from now on."""
        drawn = self.draw(site)
        return Effect(lambda measured: self.change(measured, site, drawn))

    def draw(self, site: Site) -> Any:
        """Draw values at the beginning, or make a memory, for `change`."""
        return {}

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Change a measurement in place."""
        raise NotImplementedError


class JointFault(Fault):
    """A fault of one joint."""

    joint: str = Field("", description="name of the joint; empty for one at random")

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """See that the robot has the joint."""
        known(self.joint, robot.joints, "joint")


class ActuatorFault(Fault):
    """A fault of one actuator."""

    actuator: str = Field("", description="name of the actuator; empty for one at random")

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """See that the robot has the actuator."""
        known(self.actuator, robot.actuators, "actuator")


def at_once(restore: Callable[[], None]) -> Callable[[], bool]:
    """Return the end of an effect that is over as soon as something is restored."""

    def ended() -> bool:
        restore()
        return True

    return ended


def number(default: float, low: float, high: float, unit: str, meaning: str) -> Any:
    """A parameter with its range, which is also the one that campaigns draw from; `unit` is empty for a share."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def known(name: str, names: Sequence[str], what: str) -> None:
    """Raise `InputRefused` if a name that is not empty is unknown."""
    if name and name not in names:
        raise InputRefused(f"{what} {name!r} is unknown; {valid_choices(name, names)}")
