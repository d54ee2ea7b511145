"""The recording of a demo run over topics: one frozen record of arrays that can be saved and loaded."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.contacts import placement_of
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array, frozen, frozen_mapping
from wbc_controller.settings import ContactSettings, SurfaceContact

#: Version of the file format, incremented whenever the layout of a saved recording changes.
FORMAT = 4


@dataclass(frozen=True, slots=True)
class Event:
    """The start of a phase, which lasts until the next one.

    Attributes:
        time: simulated time since the start, s.
        name: name of the phase, such as ``squat``.
    """

    time: float
    name: str


@dataclass(frozen=True, slots=True)
class Result:
    """One line of the verdict.

    Attributes:
        name: name of the measured quantity.
        target: its target, as readable text.
        measured: its measured value, as readable text.
        passed: whether the target was met.
    """

    name: str
    target: str
    measured: str
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Placement of a contact on the robot, for drawing its forces.

    Attributes:
        frame: frame of the URDF in which it is placed.
        placement: [position, quaternion] of the contact in that frame, (7,).
        corners: corners of the support in the contact's axes, (m, 3) in m.
    """

    frame: str
    placement: Array
    corners: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "placement", _array("placement", self.placement, (7,)))
        object.__setattr__(self, "corners", _array("corners", self.corners, (None, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The recording of a demo run over topics.

    Arrays are copied and frozen. Shapes: n samples of the state, m cycles of the controller, na actuators.

    Attributes:
        robot: the robot's name.
        actuators: names of the actuators, in the order of the command.
        time: simulated time since the start, (n,) in s; never decreases.
        q: Pinocchio configuration, (n, nq).
        tau: commanded torques, (n, na) in N·m.
        effort_limits: effort limits, (na,) in N·m.
        com: centre of mass in the world, (n, 3) in m.
        com_reference: reference of the centre of mass, (n, 3) in m; NaN without a reference.
        frame_errors: per task, the norm of its error, (n,) in m or rad; NaN while the task is disabled.
        contact_wrenches: per contact, its force or wrench in the solution, (n, k) in N and N·m: a wrench in the
            contact's frame, force first (k = 6), or a force along the world's axes (k = 3). NaN or zero while inactive.
        unmodelled: vertical force on the base that the solution takes into account beside the model, (n,) in N; NaN
            without a solution.
        true_wrenches: per contact, the true force or wrench in the simulation, in the same form.
        friction: per contact, its Coulomb coefficient.
        cycle_seconds: time that each cycle of the controller took, (m,) in s.
        stage_seconds: per stage, its part of this time, (m,) in s.
        events: the phases of the run.
        results: the verdict.
        modes: the supervisor's mode from each time on, (time in s, mode).
        supports: per contact, its placement on the robot; contacts without an entry are not drawn.
        audit: results of the live audit by name, each (n,): ``energy`` and ``throughput`` in W, ``force`` in N,
            ``torque`` in N·m, and the number of ``warnings``; NaN without an audit.
    """

    robot: str
    actuators: tuple[str, ...]
    time: Array
    q: Array
    tau: Array
    effort_limits: Array
    com: Array
    com_reference: Array
    frame_errors: Mapping[str, Array]
    contact_wrenches: Mapping[str, Array]
    unmodelled: Array
    true_wrenches: Mapping[str, Array]
    friction: Mapping[str, float]
    cycle_seconds: Array
    stage_seconds: Mapping[str, Array]
    events: tuple[Event, ...]
    results: tuple[Result, ...]
    modes: tuple[tuple[float, str], ...] = ()
    supports: Mapping[str, Support] = field(default_factory=dict)
    audit: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, na = len(self.time), len(self.actuators)
        shapes: dict[str, tuple[int | None, ...]] = {
            "time": (n,),
            "q": (n, None),
            "tau": (n, na),
            "effort_limits": (na,),
            "com": (n, 3),
            "com_reference": (n, 3),
            "unmodelled": (n,),
            "cycle_seconds": (None,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, _array(name, getattr(self, name), shape))
        m = len(self.cycle_seconds)
        groups: dict[str, tuple[int | None, ...]] = {
            "frame_errors": (n,),
            "contact_wrenches": (n, None),
            "true_wrenches": (n, None),
            "stage_seconds": (m,),
            "audit": (n,),
        }
        for name, shape in groups.items():
            group = {key: _array(f"{name}[{key!r}]", value, shape) for key, value in getattr(self, name).items()}
            object.__setattr__(self, name, frozen_mapping(group))
        for name in ("friction", "supports"):
            object.__setattr__(self, name, frozen_mapping(getattr(self, name)))
        if n == 0:
            raise ValueError("time is empty; a recording has at least one sample")
        if not (np.isfinite(self.time).all() and (np.diff(self.time) >= 0.0).all()):
            raise ValueError("time must be finite and never decrease")
        for name, values in (("q", self.q), ("cycle_seconds", self.cycle_seconds)):
            if not np.isfinite(values).all():
                raise ValueError(f"{name} holds values that are not finite")
        for kind, wrenches in (("contact_wrenches", self.contact_wrenches), ("true_wrenches", self.true_wrenches)):
            for name, values in wrenches.items():
                if values.shape[1] not in (3, 6):
                    raise ValueError(f"{kind}[{name!r}] has {values.shape[1]} columns; a force has 3, a wrench has 6")

    @property
    def passed(self) -> bool:
        """Whether every target was met."""
        return all(result.passed for result in self.results)

    @property
    def duration(self) -> float:
        """Length of the run, s."""
        return float(self.time[-1] - self.time[0])

    def save(self, path: Path) -> None:
        """Write the recording as a compressed ``.npz`` file, with all other data than arrays as JSON inside it."""
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _ARRAYS}
        for name in _GROUPS:
            # Numbered, since names of tasks and contacts need not be valid file names.
            arrays |= {f"{name}.{i}": values for i, values in enumerate(getattr(self, name).values())}
        metadata = {
            "format": FORMAT,
            "robot": self.robot,
            "actuators": self.actuators,
            "groups": {name: list(getattr(self, name)) for name in _GROUPS},
            "friction": dict(self.friction),
            "events": [[event.time, event.name] for event in self.events],
            "results": [[r.name, r.target, r.measured, bool(r.passed)] for r in self.results],
            "modes": self.modes,
            "supports": {
                name: [support.frame, support.placement.tolist(), support.corners.tolist()]
                for name, support in self.supports.items()
            },
        }
        # Through an open file, because numpy would append .npz to another suffix.
        with path.open("wb") as file:
            np.savez_compressed(file, metadata=np.array(json.dumps(metadata)), **arrays)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read a recording written by `save`.

        Raises:
            ConfigurationError: if the file cannot be read or does not hold a recording.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                metadata = json.loads(str(file["metadata"][()]))
                if metadata["format"] != FORMAT:
                    raise ValueError(f"its format is {metadata['format']!r}; this version reads {FORMAT}")
                content: dict[str, Any] = {name: file[name] for name in _ARRAYS}
                for name in _GROUPS:
                    content[name] = {key: file[f"{name}.{i}"] for i, key in enumerate(metadata["groups"][name])}
                return cls(
                    robot=str(metadata["robot"]),
                    actuators=tuple(metadata["actuators"]),
                    friction={name: float(value) for name, value in metadata["friction"].items()},
                    events=tuple(Event(float(time), str(name)) for time, name in metadata["events"]),
                    results=tuple(
                        Result(str(name), str(target), str(measured), bool(passed))
                        for name, target, measured, passed in metadata["results"]
                    ),
                    modes=tuple((float(time), str(mode)) for time, mode in metadata["modes"]),
                    supports={name: Support(*support) for name, support in metadata["supports"].items()},
                    **content,
                )
        except OSError as error:
            raise ConfigurationError(f"recording {path}: cannot be read: {error.strerror or error}") from error
        except KeyError as error:
            raise ConfigurationError(f"recording {path}: not a recording of a demo run: it lacks {error}") from error
        except (ValueError, TypeError, AttributeError, IndexError, EOFError, zipfile.BadZipFile) as error:
            raise ConfigurationError(f"recording {path}: not a recording of a demo run: {error}") from error


_ARRAYS = ("time", "q", "tau", "effort_limits", "com", "com_reference", "unmodelled", "cycle_seconds")
_GROUPS = ("frame_errors", "contact_wrenches", "true_wrenches", "stage_seconds", "audit")


def supports_of(contacts: Mapping[str, ContactSettings]) -> dict[str, Support]:
    """Collect the placement of each contact of a configuration on the robot.

    Args:
        contacts: the section ``contacts`` of the robot's settings.
    """
    supports = {}
    for name, contact in contacts.items():
        shape = contact.corners if isinstance(contact, SurfaceContact) else [[0.0, 0.0]]
        corners = frozen([[*corner, 0.0] for corner in shape])
        placement = pin.SE3ToXYZQUAT(placement_of(contact.translation, getattr(contact, "rpy", (0.0, 0.0, 0.0))))
        supports[name] = Support(contact.frame, frozen(placement), corners)
    return supports


def _array(name: str, values: Any, shape: tuple[int | None, ...]) -> Array:
    """Copy and freeze an array, and check its shape, in which None stands for any length."""
    array = frozen(values)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"
        raise ValueError(f"{name} has the shape {array.shape}; it must be {wanted}")
    return array


def vertical_on_base(model: RobotModel, q: Array, forces: Array) -> float:
    """Vertical part of generalized forces on a floating base, N; 0 where it does not float.

    Args:
        model: the robot's model.
        q: configuration, (nq,).
        forces: (nv,) in N and N·m.
    """
    return float(rotation_of(q[3:7])[2] @ forces[:3]) if model.floating_base else 0.0
