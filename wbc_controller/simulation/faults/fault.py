"""The base classes of faults: validated parameters, and their effect from the beginning to the end of the fault."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.values import Section
from wbc_controller.simulation.measurement import Measurement
from wbc_controller.simulation.plant import Plant

#: Longest time until a fault starts, and longest duration, s.
LONGEST = 3600.0


class Parcel(NamedTuple):
    """A message in transit."""

    due: float  # simulated time of its delivery, s
    taken: int  # simulated time of its content, ns
    payload: bytes


@dataclass(slots=True)
class Effect:
    """The effect of a fault while it lasts.

    Attributes:
        measured: changes a measurement of the sensors.
        posted: changes the parcel of one message of a stream into the parcels that are delivered, by stream.
        torques: changes the commanded torques of the actuators, (na,) in N·m.
        each_period: called once per control period, before the physics.
        ended: called at the end, and in each period after it while the result is False: the effect is not over yet.
    """

    measured: Callable[[Measurement], None] | None = None
    posted: dict[str, Callable[[Parcel], list[Parcel]]] | None = None
    torques: Callable[[Array], Array] | None = None
    each_period: Callable[[], None] | None = None
    ended: Callable[[], bool | None] = lambda: True


@dataclass(frozen=True, slots=True)
class Site:
    """The robot on which a fault acts, and the time."""

    robot: RobotModel
    plant: Plant
    period: float  # control period, s
    began: float  # simulated time at which the fault began, s
    end: float  # simulated time at which the fault ends, s
    rng: np.random.Generator

    @property
    def passed(self) -> float:
        """Time since the beginning of the fault, s."""
        return self.plant.time - self.began

    def one_of(self, name: str, names: tuple[str, ...]) -> int:
        """Return the index of a name, or of a random one if it is empty."""
        return names.index(name) if name else int(self.rng.integers(len(names)))

    def direction(self) -> Array:
        """Draw a random horizontal direction, (3,)."""
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle), 0.0])


class Fault(Section):
    """Parameters of a fault. Each kind is a subclass; its name in messages is that of the class, as ``joint_noise``."""

    #: Part of the robot on which it acts: a heading of docs/faults.md.
    place: ClassVar[str] = ""

    start: float = Field(0.0, ge=0.0, le=LONGEST, description="time until it begins", json_schema_extra={"unit": "s"})
    duration: float = Field(1.0, gt=0.0, le=LONGEST, description="how long it lasts", json_schema_extra={"unit": "s"})
    seed: int = Field(0, ge=0, lt=2**63, description="of its random numbers")

    @classmethod
    def kind(cls) -> str:
        """Return its name in messages and files."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """Check the parameters against a robot and the names of its contacts.

        Raises:
            InputRefused: if a name is unknown.
        """

    def begin(self, site: Site) -> Effect:
        """Begin, and return the effect."""
        raise NotImplementedError


class NamedFault(Fault):
    """A fault of one joint, actuator, link or contact, whose name is the first parameter."""

    def check(self, robot: RobotModel, contacts: Sequence[str]) -> None:
        """Check that the robot has what the fault names."""
        names = {"joint": robot.joints, "actuator": robot.actuators, "contact": contacts, "link": moving_links(robot)}
        for kind in names.keys() & type(self).model_fields.keys():
            name = getattr(self, kind)
            if name and name not in names[kind]:
                raise InputRefused(f"unknown {kind} {name!r}; {valid_choices(name, names[kind])}")


class JointFault(NamedFault):
    """A fault of one joint."""

    joint: str = Field("", description="name of the joint; empty for one at random")

    def _start(self, site: Site) -> Any:
        """Return the index of the joint."""
        return site.one_of(self.joint, site.robot.joints)


class ActuatorFault(NamedFault):
    """A fault of one actuator."""

    actuator: str = Field("", description="name of the actuator; empty for one at random")

    def _start(self, site: Site) -> Any:
        """Return the index of the actuator."""
        return site.one_of(self.actuator, site.robot.actuators)


class MeasurementFault(Fault):
    """A fault that changes measurements: `_start` once, then `_spoil` for each measurement."""

    def begin(self, site: Site) -> Effect:
        """Begin, and return the effect."""
        kept = self._start(site)
        return Effect(measured=lambda measured: self._spoil(measured, site, kept))

    def _start(self, site: Site) -> Any:
        """Return the values that are drawn once, or a store for values of earlier measurements."""
        return {}

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        raise NotImplementedError


class TorqueFault(Fault):
    """A fault that changes the torques of the actuators: `_start` once, then `_change` for each command."""

    def begin(self, site: Site) -> Effect:
        """Begin, and return the effect."""
        kept = self._start(site)
        return Effect(torques=lambda tau: self._change(tau, site, kept))

    def _start(self, site: Site) -> Any:
        """Return the values that are drawn once, or a store for values of earlier commands."""
        return {}

    def _change(self, tau: Array, site: Site, kept: Any) -> Array:
        raise NotImplementedError


def number(default: float, low: float, high: float, unit: str, meaning: str) -> Any:
    """Define a parameter with its range, from which campaigns draw too; `unit` is empty for a share."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def moving_links(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of the links that move."""
    return tuple(f.name for f in robot.pinocchio.frames if f.type == pin.BODY and f.parentJoint > 0)


def ramped(passed: float, ramp: float) -> float:
    """Return the share of a value that grows within the time `ramp`, s."""
    return min(1.0, passed / ramp) if ramp > 0.0 else 1.0


def low_pass(site: Site, time_constant: float, kept: dict[str, Array], key: str, value: Array) -> Array:
    """Filter a value by a low-pass of first order; `kept` holds its last output by key."""
    keep = float(np.exp(-site.period / time_constant))
    kept[key] = keep * kept.get(key, value) + (1.0 - keep) * value
    return np.array(kept[key])
