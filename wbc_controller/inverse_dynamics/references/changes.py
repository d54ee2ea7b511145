"""The changes that commands can make: one record per kind, applied by the board between two cycles."""

from __future__ import annotations

from dataclasses import dataclass

from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class SetSetpoint:
    """Move a task's reference to a position and keep it there.

    Attributes:
        task: name of the task.
        position: in the form of the task's references.
        duration: time in which it is reached, s; None for the task's own ``setpoint_duration``.
        frame: where the position is given, if not where the task's references are: one of `relative.own_frames`, or a
            frame of the robot. It counts where it is when the setpoint is applied.
    """

    task: str
    position: Array
    duration: float | None = None
    frame: str = ""


@dataclass(frozen=True, slots=True)
class SetTrajectory:
    """Follow points whose times count from `start`, in s on the clock of the states; None means now."""

    task: str
    start: float | None
    points: tuple[Knot, ...]


@dataclass(frozen=True, slots=True)
class SetWeight:
    """Change the weight of a task."""

    task: str
    weight: float


@dataclass(frozen=True, slots=True)
class EnableTask:
    """Switch a task on or off."""

    task: str
    enabled: bool


@dataclass(frozen=True, slots=True)
class EnableContact:
    """Activate or deactivate a contact.

    Attributes:
        contact: name of the contact.
        enabled: whether it is active afterwards.
        ramp: time in which it is loaded or unloaded, s; None for the contact's own ``ramp``.
    """

    contact: str
    enabled: bool
    ramp: float | None = None


@dataclass(frozen=True, slots=True)
class SetExternalWrench:
    """Set the known external wrench at a frame, (6,) in N and N·m, world axes."""

    frame: str
    wrench: Array


@dataclass(frozen=True, slots=True)
class Walk:
    """Walk at a velocity, or stop; taken by the walker and not by the board.

    Attributes:
        velocity: forward and sideways in the robot's heading, m/s, and turning rate, rad/s, (3,); None to stop.
        streamed: whether the robot stops if no other command follows within ``walking.command_timeout``.
    """

    velocity: Array | None
    streamed: bool = False


Change = SetSetpoint | SetTrajectory | SetWeight | EnableTask | EnableContact | SetExternalWrench | Walk
