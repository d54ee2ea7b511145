"""Whether states are plausible, whether the robot has fallen, and how long something has lasted.

These checks compare consecutive states, so that they remember; the others are functions, in `checks`.
All comparisons are written so that NaN fails them.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import all_finite, all_true, largest
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Fault, RobotState
from wbc_controller.safety.plausibility_kernels import (
    ABSURD,
    BASE_REPEATS,
    JOINTS_REPEAT,
    JUMPED,
    STUCK,
    UNTOLD,
    StateMemory,
    compare,
)
from wbc_controller.safety.plausibility_kernels import MEMORY as MEMORY  # exported with the checks that it belongs to

#: Speed times time below which values that repeat are those of a robot at rest, rad or m.
REST = 1.0e-6
#: Smallest velocity limit that counts, rad/s, and the one of joints without a limit: URDFs have zeros there.
SLOWEST, UNLIMITED = 1.0, 1.0e3
#: Time between two comparisons of the base's height, s.
HEIGHT_PERIOD = 0.01
#: Least height of the base at the activation for which there is a smallest height, m.
LEAST_HEIGHT = 0.1
#: Difference from a turn up to which a jump is that of an encoder that wraps, rad.
_NEARLY_A_TURN = 0.3

AXES = tuple(f"base {kind} {axis}" for kind in ("motion along", "rotation about") for axis in "xyz")


@dataclass(frozen=True, slots=True)
class PlausibilityLimits:
    """Limits of plausible states."""

    magnitude: float  # largest joint position or base coordinate, rad or m
    joint_speed: float  # largest joint velocity, as a multiple of the velocity limit
    base_speed: float  # largest velocity of the base, m/s
    base_turn: float  # largest angular velocity of the base, rad/s
    joint_mismatch: float  # largest difference between the change of a joint position and its velocity, integrated, rad
    base_mismatch: float  # likewise of the position of the base, m
    base_turn_mismatch: float  # likewise of its orientation, rad
    frozen_motion: float  # motion that a joint's velocity may tell while its position stays at one value, rad
    frozen_time: float  # longest time for which the joints, or the base, may repeat all values while moving, s


class StateWatch:
    """Compares each state with limits, and with the states before it.

    Attributes:
        doubt: what is wrong with the newest state; None where it is plausible.
        some_untold: whether a velocity tells of a motion that a position does not.
    """

    STATE_FIELDS = (
        "doubt", "_state", "_before", "_v_before", "_mismatch", "_untold", "some_untold", "_joint_values",
        "_base_values",
    )  # fmt: skip

    def __init__(self, model: RobotModel, limits: PlausibilityLimits) -> None:
        self.doubt: Fault | None = None
        self._limits = limits
        self._speed_limits = joint_speed_limits(model, limits.joint_speed)
        self._names = _names(model)
        # Largest velocities, mismatches, and motions untold.
        self._bounds = np.full((3, model.nv), np.inf)
        self._fastest, self._tolerance, self._stuck = self._bounds
        self._fastest[model.v_index] = self._speed_limits
        self._tolerance[model.v_index] = limits.joint_mismatch
        self._stuck[model.v_index] = limits.frozen_motion
        self._joint_values = _Group("the joint states", model.v_places, limits.frozen_time)
        self._base_values = (
            _Group("the base's pose and twist", slice(0, 6), limits.frozen_time) if model.floating_base else None
        )
        if model.floating_base:
            self._fastest[:3], self._fastest[3:6] = limits.base_speed, limits.base_turn
            self._tolerance[:3], self._tolerance[3:6] = limits.base_mismatch, limits.base_turn_mismatch
        self._state: RobotState | None = None
        self._before, self._v_before = np.zeros(model.nq), np.zeros(model.nv)
        self._mismatch = np.zeros(model.nv)  # change of the positions less the integrated velocities, with MEMORY
        self._untold = np.zeros(model.nv)  # integrated velocities while the position stays, with MEMORY
        self.some_untold = False
        self._memory = StateMemory(
            q_index=model.q_index,
            v_index=model.v_index,
            base_q=np.arange(7 if model.floating_base else 0),
            base_v=np.arange(6 if model.floating_base else 0),
            magnitude=limits.magnitude,
            fastest=self._fastest,
            tolerance=self._tolerance,
            motionless=self._stuck,
            before=self._before,
            v_before=self._v_before,
            mismatch=self._mismatch,
            untold=self._untold,
        )

    def look(self, state: RobotState) -> Fault | None:
        """Compare a state with the one before it, and return the fault, or None; the same state twice counts once."""
        before = self._state
        if state is before:
            return self.doubt
        found = 0
        if before is not None:
            elapsed = 1.0e-9 * (state.stamp - before.stamp)
            found = compare(self._memory, state.q, state.v, elapsed, self.some_untold)
        elif self._absurd(state) is None:
            self._before[:], self._v_before[:] = state.q, state.v
        else:
            found = ABSURD
        if found & ABSURD:  # it is not compared with
            self.doubt = self._absurd(state)
            return self.doubt
        self._state = state
        if found == 0:
            self.doubt, self.some_untold = None, False
            self._joint_values.since = state.stamp
            if self._base_values is not None:
                self._base_values.since = state.stamp
        else:
            self.doubt = self.x(found, state)
        return self.doubt

    def damped(self, joint_velocity: Array) -> Array | None:
        """Joint velocities, (nj,), with those that are not plausible set to zero: they are no reason for a torque.

        None where one is not finite.
        """
        speeds = np.abs(joint_velocity)
        if all_true(speeds <= self._speed_limits):
            return joint_velocity
        if not all_finite(joint_velocity):
            return None
        return np.where(speeds <= self._speed_limits, joint_velocity, 0.0)

    def _absurd(self, state: RobotState) -> Fault | None:
        limits = self._limits
        magnitudes = np.abs(state.q)
        if not (largest(magnitudes) <= limits.magnitude):
            i = int(magnitudes.argmax())
            return _fault(
                f"the configuration's value {i} is {state.q[i]:.3g} (limit {limits.magnitude:g} rad or m, "
                "safety.max_magnitude)"
            )
        good = np.abs(state.v) <= self._fastest
        if all_true(good):
            return None
        i = int((~good).argmax())
        key = "max_joint_speed" if i in self._names.joints else "max_base_speed" if i < 3 else "max_base_turn"
        return _fault(
            f"{self._names.of(i)} has the velocity {state.v[i]:.3g} {'m/s' if key == 'max_base_speed' else 'rad/s'} "
            f"(limit {self._fastest[i]:.3g}, safety.{key})"
        )

    def x(self, found: int, state: RobotState) -> Fault | None:
        """What follows from what a comparison has found; the first fault counts."""
        self.some_untold = bool(found & UNTOLD)
        fault = None
        if found & JUMPED:
            fault = self._beyond(_JUMP, self._mismatch, self._tolerance)
        elif found & STUCK:
            fault = self._beyond(_STUCK, self._untold, self._stuck)
            self._untold[:] = 0.0
        if fault is not None:  # what has led to it is forgotten
            self._mismatch[:] = 0.0
        if not found & JOINTS_REPEAT:
            self._joint_values.since = state.stamp
        elif fault is None:
            fault = self._joint_values.still(state)
        if self._base_values is not None:
            if not found & BASE_REPEATS:
                self._base_values.since = state.stamp
            elif fault is None:
                fault = self._base_values.still(state)
        return fault

    def _beyond(self, what: str, values: Array, limits: Array) -> Fault:
        """Name the first value over its limit."""
        i = int((~(np.abs(values) <= limits)).argmax())
        key = "frozen_motion" if what is _STUCK else self._names.mismatch_key(i)
        sentence = what.format(name=self._names.of(i), value=values[i], unit="m" if key == "base_mismatch" else "rad")
        hint = wrap_hint(float(values[i])) if what is _JUMP and i in self._names.joints else ""
        return _fault(f"{sentence}{hint} (limit {limits[i]:.3g}, safety.{key})")


class _Group:
    """The values of one message: joint states or odometry.

    Attributes:
        since: stamp of the state since which they have repeated, ns.
    """

    STATE_FIELDS = ("since",)

    def __init__(self, what: str, v_places: np.ndarray | slice, limit: float) -> None:
        self.since = 0
        self._what = what
        self._v_places = v_places
        self._limit = limit

    def still(self, state: RobotState) -> Fault | None:
        """Judge values that repeat bit for bit although the robot moves: sensors that have died behind fresh stamps."""
        if state.stamp < self.since:
            self.since = state.stamp
            return None
        lasted = 1.0e-9 * (state.stamp - self.since)
        if lasted <= self._limit or not (largest(np.abs(state.v[self._v_places])) * lasted > REST):
            return None
        return _fault(
            f"{self._what} have repeated for {1e3 * lasted:.0f} ms at velocities that are not zero "
            f"(limit {1e3 * self._limit:.0f} ms, safety.frozen_time)"
        )


_JUMP = "{name} differs by {value:.3g} {unit} from what its velocity says"
_STUCK = "{name} has stayed at one value while its velocity says that it moved by {value:.3g} {unit}"


class _Names:
    """What each generalized velocity belongs to, for sentences."""

    def __init__(self, names: dict[int, str], joints: frozenset[int]) -> None:
        self.joints = joints
        self._names = names

    def of(self, i: int) -> str:
        return self._names.get(i, f"generalized velocity {i}")

    def mismatch_key(self, i: int) -> str:
        return "joint_mismatch" if i in self.joints else "base_mismatch" if i < 3 else "base_turn_mismatch"


def _names(model: RobotModel) -> _Names:
    places = model.v_index.tolist()
    names = {place: f"joint {name!r}" for place, name in zip(places, model.joints, strict=True)}
    if model.floating_base:
        names |= dict(enumerate(AXES))
    return _Names(names, frozenset(places))


def wrap_hint(change: float) -> str:
    """Return the probable reason of a joint's jump by a turn, rad; otherwise an empty text."""
    if abs(abs(change) - 2.0 * math.pi) > _NEARLY_A_TURN:
        return ""
    return ": a jump by a turn; a driver whose encoder wraps at ±π has to unwrap it"


def joint_speed_limits(model: RobotModel, multiple: float) -> Array:
    """Largest plausible velocity of each joint, (nj,) in rad/s, from a multiple of the velocity limits."""
    limits = np.where(model.velocity_limits > 0.0, np.maximum(model.velocity_limits, SLOWEST), UNLIMITED)
    return np.asarray(np.minimum(multiple * limits, UNLIMITED))


@dataclass(frozen=True, slots=True)
class FallLimits:
    """Limits beyond which a robot with a floating base has fallen."""

    tilt: float  # largest angle between the base's upward direction and that at the activation, rad
    height: float  # smallest height of the base above the lowest end of a limb, as a share of that at the activation


class FallWatch:
    """Compares the base with where it was at the activation.

    Its height is counted from the lowest end of a limb and not from the ground, so that stairs and slopes do not count.

    Attributes:
        floating: whether the base floats; a fixed one never falls.
        upward: the world's z axis in the base's axes at the activation, (3,).
    """

    STATE_FIELDS = ("upward", "_begun", "_height", "_looked")

    def __init__(self, model: RobotModel, limits: FallLimits) -> None:
        self._limits = limits
        self.floating = model.floating_base
        self._pin, self._data = model.pinocchio, model.pinocchio.createData()
        self._limbs = _limb_ends(model.pinocchio) if model.floating_base else []
        self.upward, self._begun = (0.0, 0.0, 1.0), False
        self._height = 0.0  # at the activation, m
        self._least_cosine = math.cos(limits.tilt) if limits.tilt < math.pi else -math.inf  # of the tilt
        self._looked = -math.inf

    def begin(self) -> None:
        """Start anew: the next state is the one of the activation."""
        self._begun = False

    def look(self, now: float, state: RobotState) -> Fault | None:
        """Compare a plausible state with that of the activation, at a time in s; return the fault, or None."""
        if not self.floating:
            return None
        limits = self._limits
        if not self._begun:
            self.upward, self._height, self._looked = upward(state.q), self._height_of(state), now
            self._begun = True
            return None
        (a, b, c), (x, y, z) = self.upward, upward(state.q)
        cosine = a * x + b * y + c * z
        if not (cosine >= self._least_cosine):
            tilted = math.acos(max(-1.0, min(1.0, cosine)))
            return Fault(
                "FALLEN",
                f"the base is tilted by {tilted:.2f} rad from where it was at the activation (limit {limits.tilt:.2f} "
                "rad, safety.max_tilt)",
            )
        if limits.height > 0.0 and self._height >= LEAST_HEIGHT and not (0.0 <= now - self._looked < HEIGHT_PERIOD):
            self._looked = now
            high = self._height_of(state)
            if not (high >= limits.height * self._height):
                return Fault(
                    "FALLEN",
                    f"the base is {high:.3f} m above the lowest limb (limit {limits.height:g} of the "
                    f"{self._height:.3f} m at the activation, safety.min_height)",
                )
        return None

    def _height_of(self, state: RobotState) -> float:
        """Return the height of the base above the lowest end of a limb, m; -inf without limbs."""
        pin.forwardKinematics(self._pin, self._data, state.q)
        ends = (self._data.oMi[joint].act(end)[2] for joint, end in self._limbs)
        return float(state.q[2]) - min(ends, default=math.inf)


def upward(q: Array) -> tuple[float, float, float]:
    """Return the world's z axis in the axes of a floating base, from a configuration, (nq,)."""
    x, y, z, w = q[3:7].tolist()
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _limb_ends(model: pin.Model) -> list[tuple[int, Array]]:
    """Each last joint of a limb, with the origin of its frame that is farthest from it, (3,) in m."""
    inner = {int(parent) for parent in list(model.parents)[1:]}
    ends = {joint: np.zeros(3) for joint in range(2, model.njoints) if joint not in inner}
    for frame in model.frames:
        place = np.array(frame.placement.translation)
        if frame.parentJoint in ends and np.linalg.norm(place) > np.linalg.norm(ends[frame.parentJoint]):
            ends[frame.parentJoint] = place
    return list(ends.items())


class Budget:
    """Time that was spent within a sliding window."""

    STATE_FIELDS = ("_spent", "_total")

    def __init__(self) -> None:
        self._spent: deque[tuple[float, float]] = deque()
        self._total = 0.0

    def spend(self, now: float, seconds: float) -> None:
        """Add a time that ends now."""
        self._spent.append((now, seconds))
        self._total += seconds

    def within(self, now: float, window: float) -> float:
        """Time spent within the window that ends now, s; what was before is forgotten."""
        while self._spent and not (now - self._spent[0][0] < window):
            self._total -= self._spent.popleft()[1]
        if not self._spent:
            self._total = 0.0
        return self._total


def _fault(sentence: str) -> Fault:
    return Fault("IMPLAUSIBLE_STATE", sentence)
