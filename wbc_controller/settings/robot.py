"""Settings of the robot: its model, its joints and its actuators."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from wbc_controller.settings.values import Finite, NonNegative, Positive, Section


def _joined(values: Any, is_value: Callable[[Any], bool], above: str = "") -> Any:
    """Join the parts of joint names with dots, which are nested in a configuration: ``{a: {b: 1}}`` to ``{a.b: 1}``."""
    if not isinstance(values, Mapping):
        return values
    joined: dict[str, Any] = {}
    for name, value in values.items():
        if is_value(value) or not isinstance(value, Mapping) or not value:
            joined[f"{above}{name}"] = value
        else:
            joined |= _joined(value, is_value, f"{above}{name}.")
    return joined


def _by_joint(*keys: str) -> BeforeValidator:
    """Join names in a dictionary by joint, with values or with sections that have some of the keys."""

    def is_section(value: Any) -> bool:
        return isinstance(value, Mapping) and not value.keys().isdisjoint(keys)

    return BeforeValidator(lambda values: _joined(values, is_section))


class PassiveJointSettings(Section):
    """Spring and damper of a joint without a motor of its own: torque = stiffness · (rest - q) - damping · q̇."""

    stiffness: NonNegative = Field(0.0, le=1.0e6, description="Stiffness of the spring, N·m/rad.")
    damping: NonNegative = Field(0.0, le=1.0e5, description="Coefficient of the damper, N·m·s/rad.")
    rest: Finite = Field(0.0, description="Joint position at which the spring is at rest, rad.")


class TransmissionSettings(Section):
    """An actuator other than the motor of a single joint, such as one that drives several joints."""

    ratios: Annotated[dict[str, Finite], _by_joint()] = Field(
        min_length=1,
        description="Ratio by joint name: turns of the actuator per turn of the joint. The actuator's speed is the sum "
        "of ratio times joint speed, and its torque acts at each of these joints as ratio times torque.",
    )
    effort_limit: Positive = Field(description="Largest torque of the actuator, N·m.")
    rotor_inertia: NonNegative = Field(
        0.0, le=10.0, description="Inertia of the parts that turn at the actuator's speed, kg·m²."
    )


class JointLimitSettings(Section):
    """Limits of one joint in place of those of the URDF; a value that is not given stays the URDF's."""

    effort: Positive | None = Field(None, le=1.0e6, description="Largest torque, N·m; of a prismatic joint, N.")
    velocity: Positive | None = Field(None, le=1.0e4, description="Largest speed, rad/s or m/s.")
    lower: Finite | None = Field(None, description="Lower position limit, rad or m.")
    upper: Finite | None = Field(None, description="Upper position limit, rad or m.")

    @model_validator(mode="after")
    def _some(self) -> JointLimitSettings:
        if all(value is None for value in (self.effort, self.velocity, self.lower, self.upper)):
            raise ValueError("gives no limit; it takes effort, velocity, lower or upper")
        if self.lower is not None and self.upper is not None and not (self.lower < self.upper):
            raise ValueError(f"lower = {self.lower}: must be below upper = {self.upper}")
        return self


class FrictionSettings(Section):
    """Friction of one joint."""

    dry: NonNegative = Field(0.0, le=1.0e4, description="Dry (Coulomb) friction, N·m; of a prismatic joint, N.")
    viscous: NonNegative = Field(0.0, le=1.0e4, description="Viscous friction, N·m·s/rad or N·s/m.")


class RobotSettings(Section):
    """The robot: its model, its joints, their actuators, and the nominal posture."""

    urdf: str = Field(
        "",
        description="Path, or package://<package>/<path in its share folder> of a ROS 2 package on AMENT_PREFIX_PATH "
        "or a Python distribution. A relative path starts at the configuration file's folder. Empty: the URDF "
        "comes from the topic robot_description.",
    )
    base: Literal["floating", "fixed"] = Field("floating", description="How the root link is attached to the world.")
    joints: list[str] = Field(
        min_length=1,
        description="Joints that move and are measured. A joint that mimics one of them in the URDF follows it; all "
        "other joints are locked.",
    )
    actuators: list[str] = Field(
        default_factory=list,
        description="Actuators in the order of the effort command: names of joints with a motor of their own, and "
        "names in `transmission`. Empty: one motor at each joint that is not passive, in the order of `joints`.",
    )
    transmission: dict[str, TransmissionSettings] = Field(
        default_factory=dict, description="Actuators other than the motor of a single joint, by name."
    )
    command: Literal["actuators", "joints"] = Field(
        "actuators",
        description="Content of the effort command: torques of the actuators; or, for a robot whose drivers handle the "
        "transmissions, torques at the driven joints in the order of `joints`.",
    )
    passive_joints: Annotated[dict[str, PassiveJointSettings], _by_joint(*PassiveJointSettings.model_fields)] = Field(
        default_factory=dict, description="The joints in `joints` that have no motor of their own."
    )
    locked_joints: Annotated[dict[str, Finite], _by_joint()] = Field(
        default_factory=dict, description="Positions of joints that are locked at a position other than zero, rad."
    )
    joint_limits: Annotated[dict[str, JointLimitSettings], _by_joint(*JointLimitSettings.model_fields)] = Field(
        default_factory=dict,
        description="Limits of single joints that replace those of the URDF, by joint: for the controller, the guard "
        "and the mock robot.",
    )
    friction: Annotated[dict[str, FrictionSettings], _by_joint(*FrictionSettings.model_fields)] = Field(
        default_factory=dict,
        description="Friction of single joints, which the controller makes up for, by joint; `wbc identify` finds it.",
    )
    posture: list[Finite] = Field(description="Nominal position of each joint, rad.")
    effort_limit_scale: Annotated[Positive, Field(le=1.0)] = Field(
        1.0, description="Usable share of the effort limits in the URDF, `joint_limits` and `transmission`."
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
