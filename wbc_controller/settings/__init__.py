"""Schema of a robot's configuration file.

The file is a ROS 2 parameter file. Unknown keys are errors.
"""

from pydantic import Field, model_validator

from wbc_controller.settings import service
from wbc_controller.settings.contacts import ContactSettings, LoopSettings
from wbc_controller.settings.estimation import EstimationSettings
from wbc_controller.settings.limits import LimitSettings
from wbc_controller.settings.robot import RobotSettings
from wbc_controller.settings.tasks import TaskSettings
from wbc_controller.settings.values import Name, Section
from wbc_controller.settings.walking import WalkingSettings

NODE_NAME = "wbc_controller"


class Settings(Section):
    """Configuration of one robot."""

    robot: RobotSettings
    control: service.ControlSettings = service.ControlSettings()
    solver: service.SolverSettings = service.SolverSettings()
    limits: LimitSettings = LimitSettings()
    safety: service.SafetySettings = service.SafetySettings()
    estimation: EstimationSettings = EstimationSettings()
    guard: service.GuardSettings = service.GuardSettings()
    audit: service.AuditSettings = service.AuditSettings()
    recorder: service.RecorderSettings = service.RecorderSettings()
    tasks: dict[Name, TaskSettings] = Field(min_length=1)
    contacts: dict[Name, ContactSettings] = Field(default_factory=dict)
    loops: dict[Name, LoopSettings] = Field(default_factory=dict)
    walking: WalkingSettings | None = None
    mock: service.MockSettings = service.MockSettings()

    @model_validator(mode="after")
    def _distinct(self) -> "Settings":
        both = sorted(set(self.contacts) & set(self.loops))
        if both:
            raise ValueError(f"loops: {', '.join(map(repr, both))} is also the name of a contact; use different names")
        return self
