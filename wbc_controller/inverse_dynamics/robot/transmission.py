"""Motors and transmissions, without Pinocchio."""

from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.records import Array, frozen
from wbc_controller.settings.robot import RobotSettings

_INDEPENDENT = 1.0e-6  # smallest independent part of normalized ratios


class Drive:
    """Actuators and their ratios R to the joints: actuator speeds R q̇, joint torques Rᵀτ."""

    def __init__(
        self,
        names: Sequence[str],
        effort_limits: Array,
        ratios: Array,
        *,
        rotor_inertia: Array | None = None,
        by_joint: bool = False,
    ) -> None:
        """Make a drive; raises `ConfigurationError` for dependent actuators."""
        _require_independent(names, ratios)
        self.names = tuple(names)  # in the order of the command, (na,)
        self.effort_limits = frozen(effort_limits)  # before scaling, (na,) in N·m
        self.ratios = frozen(ratios)  # R of full row rank, (na, nj)
        self.driven: np.ndarray = np.any(ratios, axis=0)  # True for joints with an actuator, (nj,)
        #: Of transmissions, (na,) in kg·m²; 0 for motors.
        self.rotor_inertia = frozen(np.zeros(len(names)) if rotor_inertia is None else rotor_inertia)
        self.by_joint = by_joint  # True for joint torques in the command
        self.command_size = int(np.count_nonzero(self.driven)) if by_joint else len(self.names)
        picks = np.count_nonzero(ratios, axis=1) == 1
        #: Joint of each actuator, (na,); None with several joints per actuator or ratios other than 1.
        self.motors = ratios.argmax(axis=1) if picks.all() and (ratios[ratios != 0.0] == 1.0).all() else None
        self._is_identity = self.motors is not None and np.array_equal(self.motors, np.arange(ratios.shape[1]))
        self._from_joints = np.linalg.solve(ratios @ ratios.T, ratios)

    def rates(self, joint_velocities: Array) -> Array:
        """Return the actuator speeds R q̇, (nj,) to (na,)."""
        return np.asarray(joint_velocities[self.motors] if self.motors is not None else self.ratios @ joint_velocities)

    def at_joints(self, tau: Array) -> Array:
        """Return the joint torques Rᵀτ, (na,) to (nj,)."""
        return tau if self._is_identity else np.asarray(tau @ self.ratios)

    def from_joints(self, torques: Array) -> Array:
        """Return the actuator torques closest to joint torques, (R Rᵀ)⁻¹ R τ, (nj,) to (na,)."""
        return np.asarray(torques[self.motors] if self.motors is not None else self._from_joints @ torques)

    def command(self, tau: Array) -> Array:
        """Return the effort command for actuator torques (na,)."""
        return np.asarray(self.at_joints(tau)[self.driven]) if self.by_joint else tau

    def from_command(self, values: Array) -> Array:
        """Return the actuator torques (na,) of an effort command (command_size,)."""
        if not self.by_joint:
            return values
        torques = np.zeros(self.ratios.shape[1])
        torques[self.driven] = values
        return self.from_joints(torques)


def make_drive(robot: RobotSettings, joint_efforts: Array) -> Drive:
    """Make the drive of a robot; `joint_efforts` are the limits in its URDF, (nj,) in N·m.

    Unknown names, joints neither driven nor passive, and dependent actuators raise `ConfigurationError`.
    """
    joints, passive, transmission = robot.joints, robot.passive_joints, robot.transmission
    motors = [name for name in joints if name not in passive]
    if transmission and not robot.actuators:
        raise ConfigurationError(
            f"robot.actuators: required with robot.transmission, for the order of the command; valid: "
            f"{', '.join(dict.fromkeys([*motors, *transmission]))}"
        )
    names = robot.actuators or motors
    missing = [name for name in transmission if name not in names]
    if missing:
        raise ConfigurationError(f"robot.actuators: {missing[0]!r} of robot.transmission is missing")
    ratios, limits = np.zeros((len(names), len(joints))), np.zeros(len(names))
    for row, name in enumerate(names):
        given = transmission.get(name)
        if given is None:
            invalid = " is neither in robot.transmission nor a joint of robot.joints that can have a motor"
            require_known(name, [*transmission, *motors], "robot.actuators:", invalid)
            ratios[row, joints.index(name)] = 1.0
            limits[row] = joint_efforts[joints.index(name)]
            if not (0.0 < limits[row] < np.inf):
                raise ConfigurationError(
                    f"robot.urdf: joint {name!r} has the effort limit {limits[row]}; it must be positive: correct the "
                    f"URDF, set robot.joint_limits.{name}.effort, or list the joint in robot.passive_joints"
                )
            continue
        limits[row] = given.effort_limit
        require_known(given.ratios, joints, f"robot.transmission.{name}.ratios:", " is not one of robot.joints")
        for joint, ratio in given.ratios.items():
            ratios[row, joints.index(joint)] = ratio
    for column, joint in enumerate(joints):
        if joint not in passive and not ratios[:, column].any():
            raise ConfigurationError(
                f"robot.actuators: no actuator drives joint {joint!r} (actuators: {', '.join(names)}); add one, or "
                "list the joint in robot.passive_joints"
            )
    rotors = np.array([transmission[name].rotor_inertia if name in transmission else 0.0 for name in names])
    return Drive(names, limits, ratios, rotor_inertia=rotors, by_joint=robot.command == "joints")


def _require_independent(names: Sequence[str], ratios: Array) -> None:
    if not names:
        raise ConfigurationError("robot.actuators: the list is empty; at least one actuator is required")
    rows = np.zeros((0, ratios.shape[1]))
    for name, row in zip(names, ratios, strict=True):
        size = float(np.linalg.norm(row))
        if not (0.0 < size < np.inf):
            raise ConfigurationError(
                f"robot.transmission.{name}.ratios: all ratios are zero; at least one must differ from zero"
            )
        unit = row / size
        shares = np.linalg.lstsq(rows.T, unit, rcond=None)[0] if len(rows) else np.zeros(0)
        if not (np.linalg.norm(unit - shares @ rows) > _INDEPENDENT):
            others = [names[i] for i, share in enumerate(shares.tolist()) if abs(share) > _INDEPENDENT]
            raise ConfigurationError(
                f"robot.transmission: actuator {name!r} is a linear combination of {', '.join(others)}: their torques "
                "cannot be distinguished, and the actuation matrix S needs full row rank; remove one of them"
            )
        rows = np.vstack([rows, unit])
