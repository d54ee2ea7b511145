"""Fuzzer of user-defined classes."""

# ruff: noqa: D102 - methods are documented by the base classes

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import AnchoredContact
from wbc_controller.inverse_dynamics.limits import RowLimit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import MotionTask
from wbc_controller.records import Array, Mode
from wbc_controller.settings.config import load
from wbc_controller.validation.fuzz.strategies import draw_by_key
from wbc_controller.validation.fuzz.values import FLOATS

_CYCLES = 8
_TOLERANCE = 1.0e-9


class Height(MotionTask):
    """Height of the centre of mass."""

    size = 1

    def __init__(self, model: RobotModel, name: str = "height") -> None:
        super().__init__(name, [True])

    def position(self, dynamics: Dynamics) -> Array:
        return np.array(dynamics.com[2:])

    def velocity(self, dynamics: Dynamics) -> Array:
        return dynamics.com_velocity[2:]

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        return np.asarray(position - dynamics.com[2:])

    def jacobian(self, dynamics: Dynamics) -> Array:
        return dynamics.com_jacobian[2:]

    def drift(self, dynamics: Dynamics) -> Array:
        return dynamics.com_drift[2:]


class Grip(AnchoredContact):
    """A point of a link that is held, with 3 forces and an anchor."""

    def __init__(
        self, model: RobotModel, link: str = "FL_calf", cone: Array | None = None, stiffness: float = 1.0
    ) -> None:
        cone = np.zeros((0, 3)) if cone is None else cone
        super().__init__("grip", np.eye(6)[:, :3], cone, "world", stiffness=stiffness, damping=20.0, internal=False)
        self.frame = model.frame_id(link, "grip")

    def jacobian(self, dynamics: Dynamics) -> Array:
        return dynamics.jacobian(self.frame, pin.LOCAL_WORLD_ALIGNED)[:3]

    def drift(self, dynamics: Dynamics) -> Array:
        return dynamics.drift_world(self.frame)[:3]

    def points(self, dynamics: Dynamics) -> Array:
        return np.array([dynamics.placement(self.frame).translation])

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        return np.concatenate([force, np.cross(dynamics.placement(self.frame).translation, force)])

    def bounds(self, activation: float) -> tuple[Array, Array]:
        return np.full(3, -50.0 * activation), np.full(3, 50.0 * activation)

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        return dynamics.placement(self.frame)

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        return np.asarray(anchor[:3] - dynamics.placement(self.frame).translation)


class Ceiling(RowLimit):
    """An upper bound of the vertical acceleration of the centre of mass."""

    names, kind, unit = ("ceiling:com",), "ceiling", "m/s²"

    def __init__(self, model: RobotModel, most: float = 50.0) -> None:
        self.most = most

    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        rows[:] = dynamics.com_jacobian[2]
        lower[:], upper[:] = -np.inf, self.most - dynamics.com_drift[2]


#: Class, methods and attributes by kind of object.
_KINDS: dict[str, tuple[type, tuple[str, ...], tuple[str, ...]]] = {
    "tasks": (
        Height, ("position", "velocity", "error", "jacobian", "drift", "rest", "right", "equation"),
        ("size", "rows", "weight", "level", "setpoint_duration", "stiffness", "damping", "tolerance", "enabled",
         "name"),
    ),
    "contacts": (
        Grip, ("jacobian", "drift", "bounds", "points", "wrench_in_world", "pose", "displacement"),
        ("size", "basis", "cone", "metric", "stiffness", "damping", "ramp", "bound_groups", "enabled", "name"),
    ),
    "limits": (Ceiling, ("fill",), ("names", "kind", "unit")),
}  # fmt: skip


@dataclass(frozen=True)
class HostileClass:
    """A user-defined class with one hostile member."""

    kind: str
    member: str
    after: int  # number of normal calls of a method
    value: Any  # of attribute or method; exceptions are raised

    def make(self, model: RobotModel) -> Any:
        """Make the object."""
        base, methods, _ = _KINDS[self.kind]
        if self.member not in methods:
            made = type("Own", (base,), {})(model)
            setattr(made, self.member, self.value)
            return made
        calls, original = [0], getattr(base, self.member)

        def hostile(own: Any, *arguments: Any) -> Any:
            calls[0] += 1
            if calls[0] <= self.after:
                return original(own, *arguments)
            if isinstance(self.value, Exception):
                raise self.value
            if self.member == "fill":
                arguments[2][...] = self.value
            return self.value

        return type("Own", (base,), {self.member: hostile})(model)


def _values() -> SearchStrategy[Any]:
    shapes = st.sampled_from(((), (1,), (3,), (6,), (18,), (3, 18), (1, 18), (0,), (3, 3), (2, 3)))
    floats = st.sampled_from(FLOATS)
    arrays = st.builds(np.full, shapes, floats)
    others: tuple[Any, ...] = (
        None, True, "x", b"x", 1j, [], {}, object(), [None], np.array(["a"] * 3), np.array([1j] * 3), np.zeros(3, bool),
        np.ma.masked_array(np.zeros(3), mask=[True, False, False]), np.ma.masked_array([0.0], mask=[True]),
        np.ma.masked_array(np.zeros((1, 18)), mask=True), [[1, 2], [3]], (np.zeros(3),), (np.zeros(3),) * 2,
        ["a", "b"],
        ValueError("own"), KeyError("own"), ZeroDivisionError(), RecursionError(), MemoryError(), StopIteration(),
    )  # fmt: skip
    return st.one_of(arrays, arrays, floats, st.integers(-3, 40), st.sampled_from(others))


def hostile_class() -> SearchStrategy[HostileClass]:
    """Return a strategy of classes with a hostile member."""
    members = [(kind, name) for kind, (_, methods, attributes) in _KINDS.items() for name in (*methods, *attributes)]
    after = st.sampled_from((0, 0, 1, 2, 3, 5, 8, 12, 16, 20))
    return st.builds(lambda where, *rest: HostileClass(*where, *rest), st.sampled_from(members), after, _values())


@cache
def _robot() -> RobotModel:
    return Controller("go2", preflight=False).model


def run_class(hostile: HostileClass) -> str:
    """Run a controller with a hostile class; return ``refused``, the mode and fault code, or a failure."""
    model = _robot()
    try:
        own: dict[str, Any] = {hostile.kind: [hostile.make]}
        controller = Controller(load("go2"), preflight=False, model=model, **own)
        q, v = controller.stance(), np.zeros(model.nv)
        controller.reset(q, v)
    except ConfigurationError:
        return "refused"
    except Exception as error:
        return f"wrong: {type(error).__name__}: {error}; required: ConfigurationError"
    for i in range(_CYCLES):
        try:
            result = controller.step(q, v, i * controller.period)
            repr(result)
        except Exception as error:
            return f"wrong: step raised {type(error).__name__}: {error}"
        if not (np.abs(result.tau) <= model.effort_limits * (1.0 + _TOLERANCE)).all():
            return f"wrong: torques {result.tau}"
    if result.fault is not None and result.fault.code == "INTERNAL_ERROR":
        return f"wrong: {result.fault.sentence}"
    return result.mode.value if result.mode is Mode.ACTIVE else f"{result.mode.value} {result.fault.code}"  # type: ignore[union-attr]


@dataclass(frozen=True, slots=True)
class ClassTrial:
    """One controller with a hostile class, and its result as of `run_class`."""

    number: int
    hostile: HostileClass
    result: str

    @property
    def failed(self) -> bool:
        """True if the class was neither refused nor damped."""
        return self.result.startswith("wrong")

    def __str__(self) -> str:
        return f"class {self.number}: {self.result}"


def fuzz_classes(count: int, seed: int) -> Iterator[ClassTrial]:
    """Run controllers with hostile classes."""
    logging.getLogger("wbc_controller").setLevel(logging.CRITICAL)  # failing methods log tracebacks
    with np.errstate(all="ignore"):
        for number in range(count):
            hostile = draw_by_key(hostile_class(), "classes", seed, number)
            yield ClassTrial(number, hostile, run_class(hostile))


def summary(trials: Sequence[ClassTrial]) -> Iterator[str]:
    """Yield a line with the number of each result, and a line for each failure."""
    counts = Counter(trial.result.partition(":")[0] for trial in trials).most_common()
    yield ", ".join(f"{number} {result}" for result, number in counts)
    yield from (f"{trial.hostile}: {trial.result}" for trial in trials if trial.failed)
