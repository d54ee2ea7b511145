"""The robot and its state at one moment, from topics or from a recording, as the page draws them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from wbc_controller.apps.terminal.robot_status import RobotStatus
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
    """A robot as the page draws it: its settings and model, with the tasks and contacts by name."""

    def __init__(self, settings: Settings, urdf: str | None = None) -> None:
        """Build the robot; `urdf` is the URDF if the settings name no file.

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
        self.dynamics = Dynamics(self.model)  # the dynamics at the drawn snapshot, updated by `Drawing`


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """State of a robot and its controller at one moment."""

    stamp: int  # time of the state, ns; 0 before the first one
    age: float  # wall time since the last state arrived, s; infinite before the first one
    q: Array  # configuration, (nq,)
    v: Array  # generalized velocity, (nv,)
    mode: str = ""  # the controller's mode, in a fault with its code and sentence; empty without a controller
    #: At the joints, (nj,) in N·m, in the order of the model's joints; None if none are sent.
    torques: Array | None = None
    #: Contact forces of the controller's solution, by contact, in the form of `Solution.forces`.
    forces: Mapping[str, Array] = field(default_factory=dict)
    references: References | None = None  # references of the tasks; None if the controller follows none
    status: RobotStatus | None = None  # status of the nodes; None before the first message
    silence: float = math.inf  # wall time since the controller's last status, s; infinite before the first one
    #: True if the base's pose was measured; otherwise the robot is drawn as standing on its contacts
    base_measured: bool = True

    @property
    def following(self) -> bool:
        """True if the controller follows references."""
        return self.mode.startswith(FOLLOWING)
