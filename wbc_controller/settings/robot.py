"""The robot: its model, its joints, and what drives them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import Finite, NonNegative, Positive, Section


class PassiveJointSettings(Section):
    """A joint without a motor of its own: its spring and its damper, torque = stiffness · (rest - q) - damping · q̇."""

    stiffness: NonNegative = Field(0.0, le=1.0e6, description="Of its spring, N·m/rad.")
    damping: NonNegative = Field(0.0, le=1.0e5, description="Of its damper, N·m·s/rad.")
    rest: Finite = Field(0.0, description="Where the spring is at rest, rad.")


class TransmissionSettings(Section):
    """An actuator that is not simply the motor of one joint."""

    ratios: dict[str, Finite] = Field(
        min_length=1,
        description="For joints by name, how far the actuator turns per turn of the joint: its speed is the sum of "
        "ratio times joint speed, and it gives ratio times its torque at each of these joints.",
    )
    effort_limit: Positive = Field(description="Largest torque of the actuator, N·m.")
    rotor_inertia: NonNegative = Field(
        0.0, le=10.0, description="Inertia of what turns with the actuator, at its own speed, kg·m²."
    )


class RobotSettings(Section):
    """The robot: its model, its joints, what drives them, and how it stands."""

    urdf: str = Field(
        "",
        description="Path, or package://<python distribution>/<path in its share folder>. Empty: "
        "the URDF comes from the topic robot_description.",
    )
    base: Literal["floating", "fixed"] = Field("floating", description="How the root link is attached to the world.")
    joints: list[str] = Field(
        min_length=1,
        description="Joints that move and are measured. Joints that the URDF lets mimic one of these follow it; all "
        "others are locked.",
    )
    actuators: list[str] = Field(
        default_factory=list,
        description="The actuators, in the order of the effort command: joints with a motor of their own, and names of "
        "`transmission`. Empty: one motor at each joint that is not passive, in the order of `joints`.",
    )
    transmission: dict[str, TransmissionSettings] = Field(
        default_factory=dict, description="Actuators that are not simply the motor of one joint."
    )
    command: Literal["actuators", "joints"] = Field(
        "actuators",
        description="What the effort command holds: torques of the actuators, or, for a robot whose drivers know its "
        "transmissions, the torques at the joints that are driven, in the order of `joints`.",
    )
    passive_joints: dict[str, PassiveJointSettings] = Field(
        default_factory=dict, description="Those of `joints` that have no motor of their own."
    )
    locked_joints: dict[str, Finite] = Field(
        default_factory=dict, description="Position of joints that are locked elsewhere than at zero, rad."
    )
    posture: list[Finite] = Field(description="Nominal position of each joint, rad.")
    effort_limit_scale: Annotated[Positive, Field(le=1.0)] = Field(
        1.0, description="Share of the effort limits, of the URDF and of `transmission`, that may be used."
    )
    armature: NonNegative = Field(
        0.0, le=10.0, description="Reflected rotor inertia of every joint that has a motor of its own, kg·m²."
    )

    @model_validator(mode="after")
    def _consistent(self) -> RobotSettings:
        twice = sorted({name for name in self.joints if self.joints.count(name) > 1})
        if twice:
            raise ValueError(f"joints: {', '.join(map(repr, twice))} stands more than once; name it once")
        again = sorted({name for name in self.actuators if self.actuators.count(name) > 1})
        if again:
            raise ValueError(f"actuators: {', '.join(map(repr, again))} stands more than once; each has one command")
        if len(self.posture) != len(self.joints):
            raise ValueError(
                f"posture has {len(self.posture)} values for {len(self.joints)} joints; "
                "it takes one per joint, in the same order"
            )
        return self
