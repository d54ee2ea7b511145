"""Settings of the robot."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from wbc_controller.settings.values import Finite, NonNegative, Positive, Section


def _joined(values: Any, is_value: Callable[[Any], bool], above: str = "") -> Any:
    """Join nested keys to joint names with dots: ``{a: {b: 1}}`` to ``{a.b: 1}``."""
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
    """Return a validator that joins the names of a dictionary by joint, with values or with sections of these keys."""

    def is_section(value: Any) -> bool:
        return isinstance(value, Mapping) and not value.keys().isdisjoint(keys)

    return BeforeValidator(lambda values: _joined(values, is_section))


class PassiveJointSettings(Section):
    """Spring and damper of a joint without a motor: torque = stiffness · (rest - q) - damping · q̇."""

    stiffness: NonNegative = Field(0.0, le=1.0e6, description="Stiffness, N·m/rad.")
    damping: NonNegative = Field(0.0, le=1.0e5, description="Damping, N·m·s/rad.")
    rest: Finite = Field(0.0, description="Joint position of zero spring torque, rad.")


class TransmissionSettings(Section):
    """Actuator that drives several joints, or one joint through a gear."""

    ratios: Annotated[dict[str, Finite], _by_joint()] = Field(
        min_length=1,
        description="Ratio by joint: actuator speed = Σ ratio · joint speed, joint torque = ratio · actuator torque.",
    )
    effort_limit: Positive = Field(description="Largest torque of the actuator, N·m.")
    rotor_inertia: NonNegative = Field(0.0, le=10.0, description="Inertia at the speed of the actuator, kg·m².")


class JointLimitSettings(Section):
    """Limits of one joint that replace the values of the URDF."""

    effort: Positive | None = Field(None, le=1.0e6, description="Largest torque, N·m; of a prismatic joint, N.")
    velocity: Positive | None = Field(None, le=1.0e4, description="Largest speed, rad/s or m/s.")
    lower: Finite | None = Field(None, description="Lower position limit, rad or m.")
    upper: Finite | None = Field(None, description="Upper position limit, rad or m.")

    @model_validator(mode="after")
    def _some(self) -> "JointLimitSettings":
        if all(value is None for value in (self.effort, self.velocity, self.lower, self.upper)):
            raise ValueError("no limit given; valid: effort, velocity, lower, upper")
        if self.lower is not None and self.upper is not None and not (self.lower < self.upper):
            raise ValueError(f"lower = {self.lower}: must be below upper = {self.upper}")
        return self


class FrictionSettings(Section):
    """Friction of one joint."""

    dry: NonNegative = Field(0.0, le=1.0e4, description="Dry (Coulomb) friction, N·m; of a prismatic joint, N.")
    viscous: NonNegative = Field(0.0, le=1.0e4, description="Viscous friction, N·m·s/rad or N·s/m.")


class RobotSettings(Section):
    """Model, joints, actuators and nominal posture."""

    urdf: str = Field(
        "",
        description="Path, or `package://<package>/<path in its share folder>`. Empty: from the topic "
        "`robot_description`.",
    )
    base: Literal["floating", "fixed"] = Field("floating", description="Attachment of the root link to the world.")
    joints: list[str] = Field(
        min_length=1, description="Moving, measured joints. Mimic joints follow them; all others are locked."
    )
    actuators: list[str] = Field(
        default_factory=list,
        description="Actuators in the order of the effort command: joints with their own motor, and names in "
        "`transmission`. Empty: the non-passive `joints`.",
    )
    transmission: dict[str, TransmissionSettings] = Field(
        default_factory=dict, description="Actuators that drive joints through transmissions, by name."
    )
    command: Literal["actuators", "joints"] = Field(
        "actuators",
        description="Effort command: torques of the actuators, or of the driven `joints`, if the drivers handle the "
        "transmissions.",
    )
    passive_joints: Annotated[dict[str, PassiveJointSettings], _by_joint(*PassiveJointSettings.model_fields)] = Field(
        default_factory=dict, description="Joints in `joints` without their own motor."
    )
    locked_joints: Annotated[dict[str, Finite], _by_joint()] = Field(
        default_factory=dict, description="Positions of locked joints, rad; default zero."
    )
    joint_limits: Annotated[dict[str, JointLimitSettings], _by_joint(*JointLimitSettings.model_fields)] = Field(
        default_factory=dict,
        description="Limits that replace the values of the URDF, by joint: for controller, guard and mock robot.",
    )
    friction: Annotated[dict[str, FrictionSettings], _by_joint(*FrictionSettings.model_fields)] = Field(
        default_factory=dict, description="Friction to be compensated, by joint; identified by `wbc identify`."
    )
    posture: list[Finite] = Field(description="Nominal position of each joint, rad.")
    effort_limit_scale: Positive = Field(1.0, le=1.0, description="Usable share of all effort limits.")
    armature: NonNegative = Field(
        0.0, le=10.0, description="Reflected rotor inertia of each joint with its own motor, kg·m²."
    )

    @model_validator(mode="after")
    def _consistent(self) -> "RobotSettings":
        for kind, names in (("joint", self.joints), ("actuator", self.actuators)):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{kind}s: duplicate {', '.join(map(repr, twice))}; name each {kind} once")
        if len(self.posture) != len(self.joints):
            raise ValueError(
                f"posture has {len(self.posture)} values for {len(self.joints)} joints; "
                "it takes one per joint, in the same order"
            )
        return self
