"""Robot and its state at one moment."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from wbc_controller.apps.terminal.status_view import RobotStatus
from wbc_controller.controller.build.contacts import make_contact
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.tasks import make_task
from wbc_controller.controller.visualization.scene import Shape
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, References
from wbc_controller.settings import Settings

FOLLOWING = ("active", "holding")  # with references


class Robot:
    """A robot for drawing: settings, model, tasks and contacts."""

    def __init__(self, settings: Settings, urdf: str | None = None) -> None:
        """Build the robot, with `urdf` if the settings name none; raise `ConfigurationError` for a mismatch."""
        self.settings = settings
        self.model = make_model(settings, urdf)
        self.contacts = {name: make_contact(name, contact, self.model) for name, contact in settings.contacts.items()}
        self.tasks = {name: make_task(name, task, self.model, self.contacts) for name, task in settings.tasks.items()}
        self.dynamics = Dynamics(self.model)  # dynamics at the drawn snapshot, updated by `Drawing`


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """State of robot and controller at one moment."""

    stamp: int  # ns; initially 0
    age: float  # wall time since the last state, s
    q: Array  # (nq,)
    v: Array  # (nv,)
    mode: str = ""  # of the controller, in a fault with code and sentence; or empty
    #: Joint torques, (nj,) in N·m, in the order of the model's joints; None without commands.
    torques: Array | None = None
    #: Contact forces of the solution by contact, in the form of `Solution.forces`.
    forces: Mapping[str, Array] = field(default_factory=dict)
    references: References | None = None  # None in modes without references
    steps: Sequence[Shape] = ()  # planned steps and swing paths
    status: RobotStatus | None = None  # None before the first message
    silence: float = math.inf  # wall time since the last status, s
    base_measured: bool = True  # False if drawn standing on its contacts
