"""Commanded changes of references."""

from dataclasses import dataclass

from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class SetSetpoint:
    """Move a task's reference to a position and hold it.

    `frame`: one of `relative.own_frames`, or a robot frame at its present pose; by default that of the references.
    """

    task: str
    position: Array  # in the form of the task's references
    duration: float | None = None  # s; None for the task's ``setpoint_duration``
    frame: str = ""


@dataclass(frozen=True, slots=True)
class SetTrajectory:
    """Follow points at times from `start`, s on the clock of the states; None means now."""

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
    """Enable or disable a task."""

    task: str
    enabled: bool


@dataclass(frozen=True, slots=True)
class EnableContact:
    """Activate or deactivate a contact."""

    contact: str
    enabled: bool
    ramp: float | None = None  # duration of loading or unloading, s; None for the contact's ``ramp``


@dataclass(frozen=True, slots=True)
class SetSlippingContacts:
    """Name all slipping contacts; their friction is reduced, and recovers slowly."""

    contacts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SetExternalWrench:
    """Set the known external wrench at a frame, (6,) in N and N·m, world axes."""

    frame: str
    wrench: Array


@dataclass(frozen=True, slots=True)
class Walk:
    """Walk at a velocity or stop; for the walker, not for the board."""

    velocity: Array | None  # forward, sideways (m/s) and turning rate (rad/s) in the heading, (3,); None to stop
    streamed: bool = False  # stop without another command within ``walking.command_timeout``


@dataclass(frozen=True, slots=True)
class WalkTo:
    """Walk to a pose on the ground and stop there; for the walker."""

    pose: Array  # x, y in m and heading in rad in the world, (3,)


@dataclass(frozen=True, slots=True)
class WalkFootsteps:
    """Step on poses of alternating soles, then stop; for the walker."""

    poses: Array  # as `WalkTo.pose`, (n, 3)


#: Changes for the walker, and all changes.
WalkingChange = Walk | WalkTo | WalkFootsteps
Change = (
    SetSetpoint
    | SetTrajectory
    | SetWeight
    | EnableTask
    | EnableContact
    | SetSlippingContacts
    | SetExternalWrench
    | WalkingChange
)
