"""Inverse kinematics of one leg or arm."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import about_z
from wbc_controller.records import Array
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.swing_kernels import Landing, at_rest, moved

#: Newton iterations, largest remaining error, m and rad, and weight of the joint motion.
_ITERATIONS, _REACHED, _LEAST_MOTION = 8, 1.0e-3, 1.0e-4
_STEPS, _HALVINGS = 6, 4  # steps and halvings in the search for the largest lift
_SAMPLES = 16  # samples of a swing
_TRIED_SPEEDS = 8  # evaluations in the search for the largest speed


class FeasibleSpeed(NamedTuple):
    """Largest speed, m/s or rad/s, and the limiting quantity; "" if the search found none."""

    speed: float
    quantity: str


class Load(NamedTuple):
    """Share of the most loaded limit, above 1 beyond it, and its text."""

    share: float
    text: str


class Leg:
    """One leg or arm, with the base upright at the origin.

    Offsets of the foot, (4,), count from the nominal posture: forward, left and up in m, and turned to the left in rad.
    """

    def __init__(
        self, model: RobotModel, frame: int, others: Sequence[int], margin: float, sole: pin.SE3 | None = None
    ) -> None:
        """Prepare the leg that moves the frame of a foot; `others` are those of the other feet.

        `margin` is the distance from the position limits, rad. `sole` is the placement of the flat sole in the frame;
        None for a point foot, which may have any orientation.
        """
        own = _chain(model, frame).difference(*(_chain(model, other) for other in others))
        #: Indices in `model.joints` of the joints that move this foot alone.
        self.joints = [i for i, name in enumerate(model.joints) if model.pinocchio.getJointId(name) in own]
        self._frame, self._sole = frame, pin.SE3.Identity() if sole is None else sole
        self._rows = 3 if sole is None else 6  # controlled directions
        self._model, self._data = model, model.pinocchio.createData()
        self._margin = margin
        self._start = pin.SE3(self.kinematics(np.array(model.posture))[0])
        self.place: Array = self._start.translation  # of the foot in the nominal posture, (3,) in m

    def posture(self, offset: Array, start: Array) -> tuple[Array, str]:
        """Return the posture, (nj,) in rad, with the foot at an offset, and the limit that it exceeds, or "".

        Newton's method from the posture `start`, (nj,).
        """
        posture, none = np.array(start), np.zeros(len(self.joints))
        goal = pin.SE3(about_z(offset[3]) @ self._start.rotation, self._start.translation + offset[:3])
        for _ in range(_ITERATIONS):
            sole, J = self.kinematics(posture)
            error = np.concatenate([goal.translation - sole.translation, pin.log3(goal.rotation @ sole.rotation.T)])
            error = error[: self._rows]
            if np.abs(error).max() <= _REACHED:
                break
            rows = np.vstack([J, _LEAST_MOTION * np.eye(len(none))])
            posture[self.joints] += np.linalg.lstsq(rows, np.concatenate([error, none]), rcond=None)[0]
        else:
            return posture, "length of the leg" if len(self.joints) >= self._rows else "number of the leg's joints"
        beyond = self._model.joint_beyond_limits(posture, self._margin)
        return posture, f"position of {beyond}" if beyond else ""

    def lift(self, most: float) -> float:
        """Return the height, at most `most` in m, to which the flat sole can be raised under the hip."""
        up, posture = np.array([0.0, 0.0, 1.0, 0.0]), np.array(self._model.posture)
        reached, step = 0.0, most / _STEPS
        for _ in range(_STEPS + _HALVINGS):
            raised, reason = self.posture((reached + step) * up, posture)
            if reason:
                step *= 0.5
            else:
                reached, posture = reached + step, raised
            if reached >= most:
                break
        return reached

    def rates(self, posture: Array, twist: Array) -> Array:
        """Return joint velocities J⁺ ν for a twist of the foot relative to the base, (6,); likewise accelerations."""
        return np.asarray(np.linalg.lstsq(self.kinematics(posture)[1], twist[: self._rows], rcond=None)[0])

    def swing_share(self, swing: Iterable[tuple[Array, Array]], speeds: Array) -> Load:
        """Return the largest share of joint speeds, (nj,) in rad/s, in a swing of `swing_of`, and its joint.

        The share is infinite if the leg cannot reach a part of the swing; then the reason replaces the joint.
        """
        worst, posture = Load(0.0, ""), np.array(self._model.posture)
        for offset, rate in swing:
            posture, reason = self.posture(offset, posture)
            if reason:
                return Load(math.inf, reason)
            twist = np.array([*rate[:3], 0.0, 0.0, rate[3]])
            share = np.abs(self.rates(posture, twist)) / speeds[self.joints]
            if share.max() > worst.share:
                joint = self._model.joints[self.joints[int(np.argmax(share))]]
                worst = Load(float(share.max()), f"velocity of {joint}")
        return worst

    def kinematics(self, posture: Array) -> tuple[pin.SE3, Array]:
        """Return the placement of the foot and its Jacobian, (6, k), or (3, k) of a point."""
        model, q, frame = self._model, self._model.configuration(posture), self._frame
        pin.computeJointJacobians(model.pinocchio, self._data, q)
        pin.updateFramePlacements(model.pinocchio, self._data)
        sole = self._data.oMf[frame] * self._sole
        J = np.array(pin.getFrameJacobian(model.pinocchio, self._data, frame, pin.LOCAL_WORLD_ALIGNED))
        J[:3] -= pin.skew(sole.translation - self._data.oMf[frame].translation) @ J[3:]
        if model.followers is not None:
            for row in J:
                model.followers.carry(row)
        return sole, J[: self._rows, model.v_index[self.joints]]


def swing_of(
    velocity: Velocity, cycle: float, duration: float, clearance: float, lowering: float = 0.0, beside: float = 0.0
) -> Iterator[tuple[Array, Array]]:
    """Yield offsets of a swing foot, (4,), and their rates, (4,), in a swing of `duration`, s.

    The base moves at the velocity v, lowered by `lowering`, m. In the middle of the swing the foot is at `clearance`
    above the ground and `beside` to the left of its nominal place, m. In each `cycle` T_c between two touchdowns, s, it
    moves by v T_c, from -v T_c / 2 to v T_c / 2.
    """
    way, turn = 0.5 * cycle * velocity.linear, 0.5 * cycle * velocity.turning
    foot = at_rest(1j * beside - way, lowering, -turn)
    landing, dt = Landing(way + 1j * beside, lowering, turn, duration), duration / _SAMPLES
    v = np.array([velocity.linear.real, velocity.linear.imag, 0.0, velocity.turning])
    for sample in range(_SAMPLES + 1):
        position, rate, _ = foot
        yield position - (sample * dt - 0.5 * duration) * v, rate - v
        foot = moved(foot, landing, clearance, sample * dt, dt)


def largest_speed(load: Callable[[float], Load], most: float) -> FeasibleSpeed:
    """Return the largest speed, at most `most`, with a load of at most 1; it rises with the speed, m/s or rad/s."""
    low, high, quantity = 0.0, most, ""
    for number in range(_TRIED_SPEEDS):
        speed = most if number == 0 else 0.5 * (low + high)
        found = load(speed)
        if found.share <= 1.0:
            low = speed
        else:
            high, quantity = speed, found.text
        if low == most:
            break
    return FeasibleSpeed(low, quantity)


def _chain(model: RobotModel, frame: int) -> set[int]:
    return set(model.pinocchio.supports[model.pinocchio.frames[frame].parentJoint])
