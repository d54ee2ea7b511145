"""Faults of contacts and sensors without odometry."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.errors import WbcError
from wbc_controller.records import IN_CONTROL, Mode
from wbc_controller.settings.config import Config
from wbc_controller.simulation.faults.base_sensors import ImuBias, ImuShock
from wbc_controller.simulation.faults.fault import LONGEST, Fault
from wbc_controller.simulation.faults.joint_sensors import JointBias
from wbc_controller.simulation.faults.messages import MessageDropout
from wbc_controller.simulation.faults.world import SlipperyFloor
from wbc_controller.validation.accuracy.estimation_trial import NO_CHANGES, Changes, EstimationTrial

#: Error of the base velocity of a wrong estimate, m/s, and its largest time without a fault, s.
WRONG, MAX_UNDETECTED = 0.2, 0.3
_SWAY, _BEAT = 0.03, 0.5  # amplitude of the sway, m, and time between points, s
_DURATION = 2.0  # duration after the mishap, s
_LIFT_TIME, _TIMEOUT = 4.0, 5.0  # time for lifting a fallen robot, and timeout of the reactivation, s
_PULL, _PULL_TIME = 1.5, 0.1  # multiple of the foot's share of the weight, and duration, s
_SLIDE, _SLIDE_TIME = 0.05, 0.5  # sliding distance of a foot, m, and largest duration, s
_DRAG, _MOST_DRAG = 20.0, 0.5  # force per missing momentum, 1/s, and its bound, share of the weight


@dataclass(frozen=True, slots=True)
class Mishap:
    """A fault of a standing and swaying robot."""

    name: str
    faults: tuple[Fault, ...] = ()  # of the mock robot, at its first contact and the last joint of that limb
    pull: bool = False  # True for an upward pull on the first contact
    slide: float = 0.0  # speed of dragging the first contact forward, m/s
    hoist: bool = False  # True for a robot on the hoist, before its activation


_ICE = SlipperyFloor(duration=LONGEST, friction=0.05)
#: Rows of the table.
MISHAPS = (
    Mishap("one foot on ice, friction 0.05", (_ICE,)),
    Mishap("one foot pulled up", pull=True),
    *(Mishap(f"one foot slides at {speed:g} m/s", (_ICE,), slide=speed) for speed in (0.1, 0.3, 0.6, 1.0)),
    *(Mishap(f"IMU silent for {ms} ms", (MessageDropout(duration=ms / 1000, stream="imu"),)) for ms in (20, 45, 90)),
    Mishap("joint states silent for 45 ms", (MessageDropout(duration=0.045, stream="joint_states"),)),
    Mishap("gyroscope bias of 0.05 rad/s", (ImuBias(duration=LONGEST, bias=0.05),)),
    Mishap("gyroscope bias of 0.1 rad/s", (ImuBias(duration=LONGEST, bias=0.1),)),
    Mishap("gyroscope bias of 0.2 rad/s", (ImuBias(duration=LONGEST, bias=0.2),)),
    Mishap("gyroscope bias of 0.1 rad/s about x", (ImuShock(duration=LONGEST, turn=0.1, force=0.0),)),
    Mishap("gyroscope bias of 0.2 rad/s about x", (ImuShock(duration=LONGEST, turn=0.2, force=0.0),)),
    Mishap("gyroscope bias of 0.2 rad/s about y", (ImuShock(duration=LONGEST, axis="y", turn=0.2, force=0.0),)),
    Mishap("accelerometer bias of 1 m/s² along x", (ImuShock(duration=LONGEST, force=1.0),)),
    Mishap("IMU shock of 20 m/s² along x for 50 ms", (ImuShock(duration=0.05, force=20.0),)),
    Mishap("IMU shock of 20 m/s² along z for 50 ms", (ImuShock(duration=0.05, axis="z", force=20.0),)),
    Mishap(
        "IMU shock of (2, 2, 0) rad/s for 50 ms",
        (
            ImuShock(duration=0.05, axis="x", turn=2.0, force=0.0),
            ImuShock(duration=0.05, axis="y", turn=2.0, force=0.0),
        ),
    ),
    Mishap("IMU shock of 5 rad/s for 1.5 s, on the hoist", (ImuShock(duration=1.5, turn=5.0, force=0.0),), hoist=True),
    Mishap("IMU shock of 20 m/s² for 0.1 s, on the hoist", (ImuShock(duration=0.1, force=20.0),), hoist=True),
    Mishap("encoder offset of 0.02 rad", (JointBias(duration=LONGEST, bias=0.02, ramp=0.0),)),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one mishap."""

    error: float  # largest error of the base velocity, m/s
    undetected: float  # longest time above `WRONG` without a fault, s
    left_out: tuple[str, ...]  # contacts excluded from the estimate
    fault_texts: tuple[str, ...] = ()  # one text per fault, in order
    ended: bool = False  # True if the controller damped the robot
    fell: bool = False  # True if the robot fell before
    recovery: float = math.nan  # from 'reset' to an active controller, s; inf if refused, NaN without damping

    @property
    def silently_wrong(self) -> bool:
        """True if the estimate was wrong for too long without a fault."""
        return not (self.undetected <= MAX_UNDETECTED) or self.fell


def run_mishap(
    robot: str | Config,
    name: str,
    sensors: str = "good",
    seed: int = 0,
    force_sensors: bool = False,
    changes: Changes = NO_CHANGES,
) -> Outcome:
    """Apply a mishap; `force_sensors` provides the true contact forces at 100 Hz."""
    mishap = next(mishap for mishap in MISHAPS if mishap.name == name)
    known = {"estimation.base_state": "imu", "mock.sensors": sensors, "mock.sensor_seed": seed}
    trial = EstimationTrial(robot, {**known, **changes}, force_sensors=force_sensors)
    try:
        if mishap.hoist:
            trial.settle()
        else:
            trial.stand()
    except WbcError as error:
        return Outcome(np.nan, np.nan, (), (f"before the mishap: {error}",))
    contact, spec = next(iter(trial.settings.contacts.items()))
    model = trial.controller.model
    moved_by = model.pinocchio.frames[model.frame_id(spec.frame, "the mishap")].parentJoint
    comparison = _Comparison(trial)
    if not mishap.hoist:
        points = [trial.origin + side * np.array([0.0, _SWAY, 0.0]) for side in (1.0, -1.0, 1.0, 0.0)]
        trial.follow((_BEAT * np.arange(1, len(points) + 1)).tolist(), points)
        comparison.follow(0.5 * _BEAT)
    place = {"contact": contact, "joint": model.pinocchio.names[moved_by]}  # of faults with these parameters
    faults = [
        fault.model_copy(update={key: place[key] for key in place if hasattr(fault, key)}) for fault in mishap.faults
    ]
    trial.mock.plan(faults, since=trial.time)
    if mishap.pull:
        share = model.mass * model.gravity / len(trial.mock.plant.contacts)
        trial.mock.plant.push(spec.frame, [0.0, 0.0, _PULL * share, 0.0, 0.0, 0.0], _PULL_TIME)
    if mishap.slide:
        end = trial.time + min(_SLIDE / mishap.slide, _SLIDE_TIME)
        comparison.follow(_DURATION, lambda: _drag(trial, spec.frame, mishap.slide) if trial.time < end else None)
    else:
        comparison.follow(_DURATION)
    return comparison.outcome(_recovery(trial) if comparison.ended or mishap.hoist else math.nan)


def _drag(trial: EstimationTrial, frame: str, speed: float) -> None:
    model, (q, v) = trial.controller.model, trial.mock.plant.state()
    data, index = model.pinocchio.createData(), model.frame_id(frame, "the mishap")
    pin.forwardKinematics(model.pinocchio, data, q, v)
    present = pin.getFrameVelocity(model.pinocchio, data, index, pin.LOCAL_WORLD_ALIGNED).linear[0]
    most = _MOST_DRAG * model.mass * model.gravity
    force = float(np.clip(_DRAG * model.mass * (speed - present), -most, most))
    trial.mock.plant.push(frame, [force, 0.0, 0.0, 0.0, 0.0, 0.0], trial.controller.period)


def _recovery(trial: EstimationTrial) -> float:
    trial.mock.plant.hold(True)
    for _ in range(round(_LIFT_TIME * trial.settings.control.rate)):
        trial.cycle()
    began = trial.time
    trial.user.send_text("command", "reset")
    while trial.time - began < _TIMEOUT:
        trial.cycle()
        if trial.report.mode is Mode.ACTIVE:
            return trial.time - began
        trial.user.send_text("command", "activate")
    return math.inf


class _Comparison:
    def __init__(self, trial: EstimationTrial) -> None:
        self._trial = trial
        self._errors: list[float] = []
        self._undetected: list[bool] = []  # True while the estimate is wrong without a fault
        self._left_out: dict[str, None] = {}
        self._fault_texts: dict[str, str] = {}
        self.ended = self._fell = False

    def follow(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """Run until the robot is damped or has fallen, with `each` before every cycle."""
        for _ in range(round(seconds * self._trial.settings.control.rate)):
            if self.ended or self._fell:
                return
            each()
            self._trial.cycle()
            fault = self._trial.report.fault
            if fault is not None:
                self._fault_texts.setdefault(fault.code, f"{fault.code}: {fault.sentence}")
            self.ended = fault is not None and self._trial.report.mode not in IN_CONTROL
            self._fell = self._trial.mock.plant.fallen and not self.ended
            if not self.ended:
                self._compare()

    def _compare(self) -> None:
        state, estimator = self._trial.report.inputs.state, self._trial.loop.estimator
        if estimator is None:
            return
        if state is None:
            self._undetected.append(False)
            if estimator.lost:
                self._fault_texts.setdefault("ESTIMATE_LOST", f"ESTIMATE_LOST: {estimator.waits_for}")
            return
        self._left_out |= dict.fromkeys(estimator.slipping)
        error = float(np.linalg.norm(state.v[:3] - self._trial.true_state[1][:3]))
        self._errors.append(error)
        self._undetected.append(error > WRONG and self._trial.report.fault is None)

    def outcome(self, recovery: float) -> Outcome:
        undetected = self._trial.controller.period * longest_run(np.array(self._undetected, dtype=np.bool_))
        left_out, texts = tuple(self._left_out), tuple(self._fault_texts.values())
        return Outcome(max(self._errors, default=0.0), undetected, left_out, texts, self.ended, self._fell, recovery)


def longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of True in booleans, (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
