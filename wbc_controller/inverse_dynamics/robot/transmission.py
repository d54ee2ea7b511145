"""The drive of the joints: own motors, transmissions or none; without Pinocchio, which the guard does not load."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.records import Array, frozen

#: Least part of an actuator's normalized ratios that must be independent of the other actuators.
_INDEPENDENT = 1.0e-6


@dataclass(frozen=True, slots=True)
class Transmission:
    """An actuator that moves one or several joints.

    Attributes:
        ratios: rotation of the actuator per rotation of the joint, by joint: the actuator's speed is Σ ratio · q̇, and
            its torque τ gives the torque ratio · τ at each of these joints.
        effort_limit: largest torque of the actuator, N·m.
        rotor_inertia: inertia of the parts that rotate with the actuator, kg·m².
    """

    ratios: Mapping[str, float]
    effort_limit: float
    rotor_inertia: float = 0.0


class Drive:
    """The actuators and their ratios R to the joints: their speeds are R q̇, and torques τ give joint torques Rᵀτ.

    Attributes:
        names: names of the actuators, in the order of the command, (na,).
        effort_limits: largest torque of each, (na,) in N·m, before any scaling of the limits.
        ratios: R, (na, nj), of full row rank.
        driven: whether any actuator moves each joint, (nj,).
        motors: index of the joint whose motor each actuator is, (na,); None if an actuator moves several joints, or has
            a ratio other than 1.
        rotor_inertia: rotor inertia of each transmission's actuator, (na,) in kg·m²; 0 for motors of joints.
        by_joint: whether the command consists of torques at the driven joints instead of torques of the actuators.
        command_size: number of torques in the effort command.
    """

    def __init__(
        self,
        names: Sequence[str],
        effort_limits: Array,
        ratios: Array,
        *,
        rotor_inertia: Array | None = None,
        by_joint: bool = False,
    ) -> None:
        """Make a drive; attributes as above, without `rotor_inertia` all rotors are massless.

        Raises:
            ConfigurationError: if the actuators are not independent of each other.
        """
        _require_independent(names, ratios)
        self.names = tuple(names)
        self.effort_limits = frozen(effort_limits)
        self.ratios = frozen(ratios)
        self.driven: np.ndarray = np.any(ratios, axis=0)
        self.rotor_inertia = frozen(np.zeros(len(names)) if rotor_inertia is None else rotor_inertia)
        self.by_joint = by_joint
        self.command_size = int(np.count_nonzero(self.driven)) if by_joint else len(self.names)
        picks = np.count_nonzero(ratios, axis=1) == 1
        self.motors = ratios.argmax(axis=1) if picks.all() and (ratios[ratios != 0.0] == 1.0).all() else None
        self._is_identity = self.motors is not None and np.array_equal(self.motors, np.arange(ratios.shape[1]))
        self._from_joints = np.linalg.solve(ratios @ ratios.T, ratios)

    def motors_of(self, joints: np.ndarray) -> np.ndarray | None:
        """Indices of the actuators that are the motors of the given joints, (k,); None where `motors` is None."""
        if self.motors is None:
            return None
        return np.array([int(np.flatnonzero(self.motors == joint)[0]) for joint in joints], dtype=np.intp)

    def rates(self, joint_velocities: Array) -> Array:
        """Speeds of the actuators, R q̇: (nj,) to (na,)."""
        return np.asarray(joint_velocities[self.motors] if self.motors is not None else self.ratios @ joint_velocities)

    def at_joints(self, tau: Array) -> Array:
        """Joint torques, (nj,) in N·m, of actuator torques, (na,): Rᵀτ."""
        return tau if self._is_identity else np.asarray(tau @ self.ratios)

    def from_joints(self, torques: Array) -> Array:
        """Actuator torques that best match joint torques (least squares), (R Rᵀ)⁻¹ R: (nj,) to (na,)."""
        return np.asarray(torques[self.motors] if self.motors is not None else self._from_joints @ torques)

    def command(self, tau: Array) -> Array:
        """The effort command for actuator torques, (na,): these themselves, or the torques at the driven joints."""
        return np.asarray(self.at_joints(tau)[self.driven]) if self.by_joint else tau

    def from_command(self, values: Array) -> Array:
        """Actuator torques, (na,), that correspond to an effort command, (command_size,)."""
        if not self.by_joint:
            return values
        torques = np.zeros(self.ratios.shape[1])
        torques[self.driven] = values
        return self.from_joints(torques)


def make_drive(
    joints: Sequence[str],
    joint_efforts: Array,
    *,
    actuators: Sequence[str] = (),
    transmission: Mapping[str, Transmission] | None = None,
    passive: Collection[str] = (),
    by_joint: bool = False,
) -> Drive:
    """Make the drive of a robot from its settings.

    The arguments are those of `from_urdf.build_model`, with the effort limits of the URDF, (nj,) in N·m, which apply to
    the joints' own motors, and the names of the joints without a motor.

    Raises:
        ConfigurationError: if a name is unknown, a joint is neither driven nor passive, or the actuators are not
            independent.
    """
    transmission = transmission or {}
    if transmission and not actuators:
        motors = [name for name in joints if name not in passive]
        raise ConfigurationError(
            f"robot.actuators: needed with robot.transmission, as it is the order of the command; choose from "
            f"{', '.join(dict.fromkeys([*motors, *transmission]))}"
        )
    names = list(actuators) or [name for name in joints if name not in passive]
    missing = [name for name in transmission if name not in names]
    if missing:
        raise ConfigurationError(f"robot.actuators: {missing[0]!r} of robot.transmission is missing in it")
    ratios, limits = np.zeros((len(names), len(joints))), np.zeros(len(names))
    for row, name in enumerate(names):
        given = transmission.get(name)
        if given is None:
            known = [*transmission, *(joint for joint in joints if joint not in passive)]
            if name not in known:
                raise ConfigurationError(
                    f"robot.actuators: {name!r} is neither in robot.transmission nor a joint of robot.joints that may "
                    f"have a motor; {valid_choices(name, known)}"
                )
            ratios[row, joints.index(name)] = 1.0
            limits[row] = joint_efforts[joints.index(name)]
            if not (0.0 < limits[row] < np.inf):
                raise ConfigurationError(
                    f"robot.urdf: joint {name!r} has the effort limit {limits[row]}; it must be positive, in the URDF "
                    f"or by robot.joint_limits.{name}.effort, or the joint be one of robot.passive_joints"
                )
            continue
        limits[row] = given.effort_limit
        for joint, ratio in given.ratios.items():
            if joint not in joints:
                raise ConfigurationError(
                    f"robot.transmission.{name}.ratios: {joint!r} is not one of robot.joints; "
                    f"{valid_choices(joint, joints)}"
                )
            ratios[row, joints.index(joint)] = ratio
    for column, joint in enumerate(joints):
        if joint not in passive and not ratios[:, column].any():
            raise ConfigurationError(
                f"robot.actuators: joint {joint!r} is driven by none of them ({', '.join(names)}); add it, or name it "
                "in robot.passive_joints"
            )
    rotors = np.array([transmission[name].rotor_inertia if name in transmission else 0.0 for name in names])
    return Drive(names, limits, ratios, rotor_inertia=rotors, by_joint=by_joint)


def _require_independent(names: Sequence[str], ratios: Array) -> None:
    """Refuse redundant actuators, whose torques cannot be told apart: R must have full row rank."""
    if not names:
        raise ConfigurationError("robot.actuators: there is none; a robot without any actuator cannot be controlled")
    rows = np.zeros((0, ratios.shape[1]))
    for name, row in zip(names, ratios, strict=True):
        size = float(np.linalg.norm(row))
        if not (0.0 < size < np.inf):
            raise ConfigurationError(f"robot.transmission.{name}.ratios: all of them are zero; it drives nothing")
        unit = row / size
        shares = np.linalg.lstsq(rows.T, unit, rcond=None)[0] if len(rows) else np.zeros(0)
        if not (np.linalg.norm(unit - shares @ rows) > _INDEPENDENT):
            others = [names[i] for i, share in enumerate(shares.tolist()) if abs(share) > _INDEPENDENT]
            raise ConfigurationError(
                f"robot.transmission: the actuator {name!r} moves only with {', '.join(others)}, so that their torques "
                "cannot be told apart: the actuation matrix S needs full row rank; leave one of them out"
            )
        rows = np.vstack([rows, unit])
