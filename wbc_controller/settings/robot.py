"""Settings of the robot."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from wbc_controller.settings.values import Finite, NonNegative, Positive, Section, key


def _joined(values: Any, keys: Sequence[str], above: str = "") -> Any:
    """Join nested keys, except sections with these keys, to joint names with dots: ``{a: {b: 1}}`` to ``{a.b: 1}``."""
    if not isinstance(values, Mapping):
        return values
    joined: dict[str, Any] = {}
    for name, value in values.items():
        if not isinstance(value, Mapping) or not value or not value.keys().isdisjoint(keys):
            joined[f"{above}{name}"] = value
        else:
            joined |= _joined(value, keys, f"{above}{name}.")
    return joined


def _by_joint(*keys: str) -> BeforeValidator:
    """Return a validator that joins the names of a dictionary by joint, with values or with sections of these keys."""
    return BeforeValidator(lambda values: _joined(values, keys))


class PassiveJointSettings(Section):
    """Spring and damper of a joint without a motor: torque = stiffness · (rest - q) - damping · q̇."""

    stiffness: NonNegative = key(0.0, "Stiffness, N·m/rad.", le=1.0e6)
    damping: NonNegative = key(0.0, "Damping, N·m·s/rad.", le=1.0e5)
    rest: Finite = key(0.0, "Joint position of zero spring torque, rad.")


class TransmissionSettings(Section):
    """Actuator that drives several joints, or one joint through a gear."""

    ratios: Annotated[dict[str, Finite], _by_joint()] = Field(
        min_length=1,
        description="Ratio by joint: actuator speed = Σ ratio · joint speed, joint torque = ratio · actuator torque.",
    )
    effort_limit: Positive = Field(description="Largest torque of the actuator, N·m.")
    rotor_inertia: NonNegative = key(0.0, "Inertia at the speed of the actuator, kg·m².", le=10.0)


class JointLimitSettings(Section):
    """Limits of one joint that replace the values of the URDF."""

    effort: Positive | None = key(None, "Largest torque, N·m; of a prismatic joint, N.", le=1.0e6)
    velocity: Positive | None = key(None, "Largest speed, rad/s or m/s.", le=1.0e4)
    lower: Finite | None = key(None, "Lower position limit, rad or m.")
    upper: Finite | None = key(None, "Upper position limit, rad or m.")

    @model_validator(mode="after")
    def _some(self) -> "JointLimitSettings":
        if all(value is None for value in (self.effort, self.velocity, self.lower, self.upper)):
            raise ValueError("no limit given; valid: effort, velocity, lower, upper")
        if self.lower is not None and self.upper is not None and not (self.lower < self.upper):
            raise ValueError(f"lower = {self.lower}: must be below upper = {self.upper}")
        return self


class FrictionSettings(Section):
    """Friction of one joint."""

    dry: NonNegative = key(0.0, "Dry (Coulomb) friction, N·m; of a prismatic joint, N.", le=1.0e4)
    viscous: NonNegative = key(0.0, "Viscous friction, N·m·s/rad or N·s/m.", le=1.0e4)


class RobotSettings(Section):
    """Model, joints, actuators and nominal posture."""

    urdf: str = key(
        "", "Path, or `package://<package>/<path in its share folder>`. Empty: from the topic `robot_description`."
    )
    base: Literal["floating", "fixed"] = key("floating", "Attachment of the root link to the world.")
    joints: list[str] = Field(
        min_length=1, description="Moving, measured joints. Mimic joints follow them; all others are locked."
    )
    actuators: list[str] = key(
        [],
        "Actuators in the order of the effort command: joints with their own motor, and names in "
        "`transmission`. Empty: the non-passive `joints`.",
    )
    transmission: dict[str, TransmissionSettings] = key(
        {}, "Actuators that drive joints through transmissions, by name."
    )
    command: Literal["actuators", "joints"] = key(
        "actuators",
        "Effort command: torques of the actuators, or of the driven `joints`, if the drivers handle the transmissions.",
    )
    passive_joints: Annotated[dict[str, PassiveJointSettings], _by_joint(*PassiveJointSettings.model_fields)] = key(
        {}, "Joints in `joints` without their own motor."
    )
    locked_joints: Annotated[dict[str, Finite], _by_joint()] = key({}, "Positions of locked joints, rad; default zero.")
    joint_limits: Annotated[dict[str, JointLimitSettings], _by_joint(*JointLimitSettings.model_fields)] = key(
        {}, "Limits that replace the values of the URDF, by joint: for controller, guard and mock robot."
    )
    friction: Annotated[dict[str, FrictionSettings], _by_joint(*FrictionSettings.model_fields)] = key(
        {}, "Friction to be compensated, by joint; identified by `wbc identify`."
    )
    posture: list[Finite] = Field(description="Nominal position of each joint, rad.")
    effort_limit_scale: Positive = key(1.0, "Usable share of all effort limits.", le=1.0)
    armature: NonNegative = key(0.0, "Reflected rotor inertia of each joint with its own motor, kg·m².", le=10.0)

    @model_validator(mode="after")
    def _consistent(self) -> "RobotSettings":
        for kind, names in (("joint", self.joints), ("actuator", self.actuators)):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{kind}s: duplicate {', '.join(map(repr, twice))}; name each {kind} once")
        if len(self.posture) != len(self.joints):
            problem = f"posture has {len(self.posture)} values for {len(self.joints)} joints"
            raise ValueError(f"{problem}; it takes one per joint, in the same order")
        return self
