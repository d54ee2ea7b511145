"""Plausibility of states, falls, time budgets (NaN fails)."""

import math
from collections import deque

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import all_finite, all_true, largest
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Fault, RobotState
from wbc_controller.safety import plausibility_kernels as kernels
from wbc_controller.safety.plausibility_kernels import MEMORY as MEMORY  # re-exported
from wbc_controller.settings.service import SafetySettings

REST = 1.0e-6  # speed times time of a robot at rest, rad or m
LEAST_LIMIT, UNLIMITED = 1.0, 1.0e3  # lower bound of velocity limits, rad/s; URDFs often contain zeros
HEIGHT_PERIOD = 0.01  # time between two checks of the base's height, s
LEAST_HEIGHT = 0.1  # height of the base at the activation below which it is not checked, m
_NEARLY_A_TURN = 0.3  # tolerance of a turn in the detection of wrapped encoders, rad

AXES = tuple(f"base {kind} {axis}" for kind in ("motion along", "rotation about") for axis in "xyz")


class StateWatch:
    """Comparison of each state with limits and the previous state; `fault` belongs to the newest state."""

    STATE_FIELDS = (
        "fault", "_state", "_before", "_v_before", "_mismatch", "_stuck_motion", "_joint_values", "_base_values",
    )  # fmt: skip

    def __init__(self, model: RobotModel, settings: SafetySettings) -> None:
        self.fault: Fault | None = None
        self._speed_limits = joint_speed_limits(model, settings.max_joint_speed)
        self._joints = frozenset(model.v_index.tolist())
        names = dict(enumerate(AXES if model.floating_base else ()))
        names |= {int(i): f"joint {name!r}" for i, name in zip(model.v_index, model.joints, strict=True)}
        self._names = [names.get(i, f"generalized velocity {i}") for i in range(model.nv)]
        fastest, tolerance, stuck_limit = np.full((3, model.nv), np.inf)
        fastest[model.v_index] = self._speed_limits
        tolerance[model.v_index] = settings.joint_mismatch
        stuck_limit[model.v_index] = settings.frozen_motion
        # Odometry may repeat until it is stale.
        frozen_time = max(settings.frozen_time, settings.state_timeout)
        self._joint_values = _ValueGroup("the joint states", model.v_places, frozen_time)
        self._base_values = _ValueGroup("the base's pose and twist", slice(0, 6), frozen_time)
        if model.floating_base:
            fastest[:6] = np.repeat([settings.max_base_speed, settings.max_base_turn], 3)
            tolerance[:6] = np.repeat([settings.base_mismatch, settings.base_turn_mismatch], 3)
        self._state: RobotState | None = None
        self._before, self._v_before = np.zeros(model.nq), np.zeros(model.nv)
        self._mismatch = np.zeros(model.nv)  # x
        self._stuck_motion = np.zeros(model.nv)  # u
        self._memory = kernels.StateMemory(
            q_index=model.q_index,
            v_index=model.v_index,
            base_q=np.arange(7 if model.floating_base else 0),
            base_v=np.arange(6 if model.floating_base else 0),
            magnitude=settings.max_magnitude,
            fastest=fastest,
            tolerance=tolerance,
            stuck_limit=stuck_limit,
            before=self._before,
            v_before=self._v_before,
            mismatch=self._mismatch,
            stuck_motion=self._stuck_motion,
        )

    def check(self, state: RobotState) -> Fault | None:
        """Return the fault of a state, or None. A repeated state has no effect."""
        before = self._state
        if state is before:
            return self.fault
        found = 0
        if before is not None:
            elapsed = 1.0e-9 * (state.stamp - before.stamp)
            found = kernels.compare(self._memory, state.q, state.v, elapsed)
        elif self._out_of_range(state) is None:
            self._before[:], self._v_before[:] = state.q, state.v
        else:
            found = kernels.OUT_OF_RANGE
        if found & kernels.OUT_OF_RANGE:  # not stored
            self.fault = self._out_of_range(state)
            return self.fault
        self._state = state
        self.fault = self._to_fault(found, state)
        return self.fault

    def plausible_velocities(self, joint_velocity: Array) -> Array | None:
        """Return joint velocities, (nj,), with zeros for implausible ones; None if one is not finite."""
        speeds = np.abs(joint_velocity)
        if all_true(speeds <= self._speed_limits):
            return joint_velocity
        if not all_finite(joint_velocity):
            return None
        return np.where(speeds <= self._speed_limits, joint_velocity, 0.0)

    def _out_of_range(self, state: RobotState) -> Fault | None:
        magnitudes, limits = np.abs(state.q), self._memory
        if not (largest(magnitudes) <= limits.magnitude):
            i = int(magnitudes.argmax())
            limit = f"limit {limits.magnitude:g} rad or m, safety.max_magnitude"
            return _fault(f"the configuration's value {i} is {state.q[i]:.3g} ({limit})")
        good = np.abs(state.v) <= limits.fastest
        if all_true(good):
            return None
        i = int((~good).argmax())
        key = "max_joint_speed" if i in self._joints else "max_base_speed" if i < 3 else "max_base_turn"
        unit, limit = "m/s" if key == "max_base_speed" else "rad/s", f"limit {limits.fastest[i]:.3g}, safety.{key}"
        return _fault(f"{self._names[i]} has the velocity {state.v[i]:.3g} {unit} ({limit})")

    def _to_fault(self, found: int, state: RobotState) -> Fault | None:
        fault = None
        if found & kernels.JUMPED:
            fault = self._limit_fault(_JUMP, self._mismatch, self._memory.tolerance)
        elif found & kernels.STUCK:
            fault = self._limit_fault(_STUCK, self._stuck_motion, self._memory.stuck_limit)
            self._stuck_motion[:] = 0.0
        if fault is not None:
            self._mismatch[:] = 0.0
        groups = (self._joint_values, kernels.JOINTS_REPEAT), (self._base_values, kernels.BASE_REPEATS)
        for values, repeats in groups:
            if not found & repeats:
                values.since = state.stamp
            elif fault is None:
                fault = values.frozen_fault(state)
        return fault

    def _limit_fault(self, what: str, values: Array, limits: Array) -> Fault:
        i = int((~(np.abs(values) <= limits)).argmax())
        of_joint = i in self._joints
        mismatch = "joint_mismatch" if of_joint else "base_mismatch" if i < 3 else "base_turn_mismatch"
        key = "frozen_motion" if what is _STUCK else mismatch
        sentence = what.format(name=self._names[i], value=values[i], unit="m" if key == "base_mismatch" else "rad")
        hint = wrap_hint(float(values[i])) if what is _JUMP and of_joint else ""
        return _fault(f"{sentence}{hint} (limit {limits[i]:.3g}, safety.{key})")


class _ValueGroup:
    """Values of one message; `since` is the stamp of their last change, ns."""

    STATE_FIELDS = ("since",)

    def __init__(self, what: str, v_places: np.ndarray | slice, limit: float) -> None:
        self.since, self._what, self._v_places, self._limit = 0, what, v_places, limit

    def frozen_fault(self, state: RobotState) -> Fault | None:
        """Return a fault if values repeat bit for bit in motion, as of dead sensors with fresh stamps."""
        if state.stamp < self.since:
            self.since = state.stamp
            return None
        lasted = 1.0e-9 * (state.stamp - self.since)
        if lasted <= self._limit or not (largest(np.abs(state.v[self._v_places])) * lasted > REST):
            return None
        limit = f"limit {1e3 * self._limit:.0f} ms, safety.frozen_time"
        return _fault(f"{self._what} have repeated for {1e3 * lasted:.0f} ms with non-zero velocities ({limit})")


_JUMP = "{name}: the position differs by {value:.3g} {unit} from the integrated velocity"
_STUCK = "{name}: the position is constant, but the integrated velocity is {value:.3g} {unit}"


def wrap_hint(change: float) -> str:
    """Return a hint if a jump is about one turn, rad; or ""."""
    if abs(abs(change) - 2.0 * math.pi) > _NEARLY_A_TURN:
        return ""
    return "; a jump by one turn: the driver must unwrap encoders that wrap at ±π"


def joint_speed_limits(model: RobotModel, multiple: float) -> Array:
    """Return the largest plausible joint velocities, (nj,) in rad/s."""
    limits = np.where(model.velocity_limits > 0.0, np.maximum(model.velocity_limits, LEAST_LIMIT), UNLIMITED)
    return np.asarray(np.minimum(multiple * limits, UNLIMITED))


class FallWatch:
    """Comparison of the base with its pose at the activation.

    The height is above the lowest end of a limb. `upward` is the vertical in base axes at the activation, (3,).
    """

    STATE_FIELDS = ("upward", "_begun", "_height", "_last_check")

    def __init__(self, model: RobotModel, settings: SafetySettings) -> None:
        self._settings = settings
        self.floating = model.floating_base
        self._pin, self._data = model.pinocchio, model.pinocchio.createData()
        self._limbs = _limb_ends(model.pinocchio) if model.floating_base else []
        self.upward, self._begun = (0.0, 0.0, 1.0), False
        self._height = 0.0  # at the activation, m
        self._least_cosine = math.cos(settings.max_tilt) if settings.max_tilt < math.pi else -math.inf
        self._last_check = -math.inf

    def begin(self) -> None:
        """Use the next state as that of the activation."""
        self._begun = False

    def check(self, now: float, state: RobotState) -> Fault | None:
        """Compare a plausible state with the activation; return the fault, or None."""
        if not self.floating:
            return None
        if not self._begun:
            self.upward, self._height, self._last_check = upward(state.q), self._height_of(state), now
            self._begun = True
            return None
        (a, b, c), (x, y, z) = self.upward, upward(state.q)
        cosine = a * x + b * y + c * z
        if not (cosine >= self._least_cosine):
            tilted, limit = math.acos(max(-1.0, min(1.0, cosine))), f"limit {self._settings.max_tilt:.2f} rad"
            sentence = f"the base has tilted by {tilted:.2f} rad since the activation ({limit}, safety.max_tilt)"
            return Fault("FALLEN", sentence)
        least = self._settings.min_height
        if least > 0.0 and self._height >= LEAST_HEIGHT and not (0.0 <= now - self._last_check < HEIGHT_PERIOD):
            self._last_check = now
            high = self._height_of(state)
            if not (high >= least * self._height):
                limit = f"limit {least:g} of the {self._height:.3f} m at the activation, safety.min_height"
                return Fault("FALLEN", f"the base is {high:.3f} m above the lowest limb ({limit})")
        return None

    def _height_of(self, state: RobotState) -> float:
        pin.forwardKinematics(self._pin, self._data, state.q)
        ends = (self._data.oMi[joint].act(end)[2] for joint, end in self._limbs)
        return float(state.q[2]) - min(ends, default=math.inf)


def upward(q: Array) -> tuple[float, float, float]:
    """Return the vertical in the axes of a floating base from a configuration, (nq,)."""
    x, y, z, w = q[3:7].tolist()
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _limb_ends(model: pin.Model) -> list[tuple[int, Array]]:
    """Return the last joint of each limb with its farthest frame origin, (3,) in m."""
    inner = {int(parent) for parent in list(model.parents)[1:]}
    ends = {joint: np.zeros(3) for joint in range(2, model.njoints) if joint not in inner}
    for frame in model.frames:
        place = np.array(frame.placement.translation)
        if frame.parentJoint in ends and np.linalg.norm(place) > np.linalg.norm(ends[frame.parentJoint]):
            ends[frame.parentJoint] = place
    return list(ends.items())


class Budget:
    """Time spent within a sliding window."""

    STATE_FIELDS = ("_spent", "_total")

    def __init__(self) -> None:
        self._spent: deque[tuple[float, float]] = deque()
        self._total = 0.0

    def spend(self, now: float, seconds: float) -> None:
        """Add a duration that ends now."""
        self._spent.append((now, seconds))
        self._total += seconds

    def within(self, now: float, window: float) -> float:
        """Return the time spent within the window, s."""
        while self._spent and not (now - self._spent[0][0] < window):
            self._total -= self._spent.popleft()[1]
        if not self._spent:
            self._total = 0.0
        return self._total


def _fault(sentence: str) -> Fault:
    return Fault("IMPLAUSIBLE_STATE", sentence)
