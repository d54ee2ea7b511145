"""What a command changes: one record per kind of change, applied by the board between two cycles."""

from __future__ import annotations

from dataclasses import dataclass

from wbc_controller.core.references.trajectories import Knot
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class SetSetpoint:
    """Go to a position and stay there."""

    task: str
    position: Array


@dataclass(frozen=True, slots=True)
class SetTrajectory:
    """Follow timed points, whose times count from `start`: s on the clock of the states; None means now."""

    task: str
    start: float | None
    points: tuple[Knot, ...]


@dataclass(frozen=True, slots=True)
class SetWeight:
    """Give a task another weight."""

    task: str
    weight: float


@dataclass(frozen=True, slots=True)
class EnableTask:
    """Switch a task on or off."""

    task: str
    enabled: bool


@dataclass(frozen=True, slots=True)
class EnableContact:
    """Make or break a contact."""

    contact: str
    enabled: bool


@dataclass(frozen=True, slots=True)
class SetExternalWrench:
    """State a known external wrench at a frame, (6,) in N and N·m, world axes."""

    frame: str
    wrench: Array


Change = SetSetpoint | SetTrajectory | SetWeight | EnableTask | EnableContact | SetExternalWrench
