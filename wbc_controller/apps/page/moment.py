"""What the page shows of one moment, wherever it comes from: topics, or a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from wbc_controller.apps.terminal.status_view import Heard
from wbc_controller.controller.build.contacts import make_contact
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.tasks import make_task
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import Array, References
from wbc_controller.settings import Settings

#: Modes in which the controller follows references.
FOLLOWING = ("active", "holding")


class Robot:
    """A robot as it is drawn: its model, with the tasks and contacts of its configuration.

    Attributes:
        settings: of the robot.
        model: its model.
        contacts: by name.
        tasks: by name.
        dynamics: the snapshot at the moment that is drawn; whoever draws updates it.
    """

    def __init__(self, settings: Settings, urdf: str | None = None) -> None:
        """Build it.

        Args:
            settings: of the robot.
            urdf: the URDF, where the settings name no file.

        Raises:
            ConfigurationError: if settings and URDF do not fit together.
        """
        self.settings = settings
        self.model: RobotModel = make_model(settings, urdf)
        self.contacts: dict[str, Contact] = {
            name: make_contact(name, contact, self.model) for name, contact in settings.contacts.items()
        }
        self.tasks: dict[str, Task] = {
            name: make_task(name, task, self.model, self.contacts) for name, task in settings.tasks.items()
        }
        self.dynamics = Dynamics(self.model)


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment.

    Attributes:
        stamp: time of the state, ns; 0 before the first one.
        age: wall time since the last state came, s; infinite before the first one.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        mode: what the controller says of its mode: the mode, and in a fault its code and sentence; empty where it says
            nothing.
        torques: at the joints, (nj,) in N·m, in the order of the model's joints; None where none are sent.
        forces: what the controller counts on, by contact, in the form of `Solution.forces`.
        references: what is wanted; None where the controller follows nothing.
        heard: what the nodes say of themselves; None before the first word.
        silence: wall time since the controller last said how it is, s; infinite before its first word.
        base_measured: whether the base's pose was measured; else it is drawn as standing on its contacts.
    """

    stamp: int
    age: float
    q: Array
    v: Array
    mode: str = ""
    torques: Array | None = None
    forces: Mapping[str, Array] = field(default_factory=dict)
    references: References | None = None
    heard: Heard | None = None
    silence: float = math.inf
    base_measured: bool = True

    @property
    def following(self) -> bool:
        """Whether the controller follows references."""
        return self.mode.startswith(FOLLOWING)
