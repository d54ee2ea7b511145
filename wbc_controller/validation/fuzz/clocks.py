"""Fuzzer of clocks and load."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.records import Mode
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.catalogue import KINDS, draw
from wbc_controller.simulation.faults.fault import Fault, FaultContext, number
from wbc_controller.simulation.sensors import Measurement
from wbc_controller.validation.campaign.monitor import MonitoredRobot, logged_errors

CLOCKS = ("simulated", "synchronized", "own")  # clocks of the controller
_DURATION, _HANGING_PERIODS = 1.2, 10  # s, and periods on the hoist before
_PERIODS_BETWEEN_ATTEMPTS, _ATTEMPTS = 5, 4  # periods between attempts, and attempts
_PAUSE_DURATION, _TIME_BETWEEN_PAUSES = (0.002, 0.1), (0.005, 0.5)  # pauses of the controller, and time between them, s
#: Kinds of fault that change only times.
_TIME_FAULTS = [kind for kind in KINDS.values() if kind.place in ("stamps and clock", "delivery")]


class ClockSteps(Fault):
    """The time on /clock moves in steps."""

    place = "stamps and clock"
    step: float = number(0.02, 0.002, 0.5, "s", "between two times")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.stamps["clock"] -= measured.stamps["clock"] % round(1.0e9 * self.step)


@dataclass(slots=True)
class ClockTrial:
    """One trial."""

    robot: str
    number: int
    clock: str
    faults: str
    late: bool  # with pauses of the controller
    result: str = "survived"  # `survived`, `refused`, or the code of the fault that ended the control
    why: str = ""  # violated invariant, or empty

    @property
    def failed(self) -> bool:
        """True if an invariant was violated."""
        return bool(self.why)

    def __str__(self) -> str:
        late = ", late" if self.late else ""
        why = f"; {self.why}" if self.why else ""
        return f"{self.robot}, trial {self.number}: {self.clock} clock, {self.faults}{late}: {self.result}{why}"


def run_trial(robot: str, seed: int, number: int) -> ClockTrial:
    """Run one trial."""
    rng = np.random.default_rng([seed, number])
    clock, late = CLOCKS[number % len(CLOCKS)], bool(rng.random() < 0.4)
    before = rng.random() < 0.3  # True for faults before the activation
    count = rng.integers(0 if late else 1, 4)
    kinds: list[type[Fault]] = [_TIME_FAULTS[i] for i in rng.choice(len(_TIME_FAULTS), count)]
    if clock == "simulated" and rng.random() < 0.5:
        kinds.append(ClockSteps)
    faults = [
        draw(
            kind,
            rng,
            start=0.0 if before else float(rng.uniform(0.2, 0.6)),
            duration=60.0 if before else float(rng.uniform(0.05, 0.6)),
            seed=int(rng.integers(2**32)),
        )
        for kind in kinds
    ]
    trial = ClockTrial(robot, number, clock, ", ".join(fault.kind() for fault in faults) or "no fault", late)
    with logged_errors() as errors, np.errstate(all="ignore"):
        try:
            _Standing(trial, faults, before, rng).run()
        except WbcError as error:
            trial.why = f"{type(error).__name__}: {error}"
    if errors:
        trial.why = f"logged error: {errors[0]}"
    return trial


class _Standing(MonitoredRobot):
    def __init__(self, trial: ClockTrial, faults: Sequence[Fault], before: bool, rng: np.random.Generator) -> None:
        changes = {
            "safety.activation_ramp": 0.0,
            "safety.synchronized_clocks": trial.clock == "synchronized",
            "control.markers_rate": 0.0,
        }
        settings = load(trial.robot).replace(changes).settings
        super().__init__(settings, stamps_lie=True, use_sim_time=trial.clock == "simulated")
        self._trial, self._faults, self._before, self._rng = trial, faults, before, rng
        self._paused_until, self._pauses_at = 0.0, math.inf

    def run(self) -> None:
        if self._before:
            self.mock.plan(self._faults, self.time)
        for _ in range(_HANGING_PERIODS):
            self._period()
        for _ in range(_ATTEMPTS):
            self.user.send_text("command", "activate")
            for _ in range(_PERIODS_BETWEEN_ATTEMPTS):
                self._period()
            if self.monitor.mode is Mode.ACTIVE:
                break
        else:
            self._trial.result = "refused"
            return self._judge()
        rising = 1.0 / self.settings.limits.torque_rate
        for _ in range(math.ceil(rising / self.controller.period)):
            self._period()
        self.mock.plant.hold(False, ramp=0.0)
        if not self._before:
            self.mock.plan(self._faults, self.time)
        if self._trial.late:
            self._pauses_at = self.time
        end = self.time + _DURATION
        while self.time < end and self.monitor.deactivation is None:
            self._period()
            if self.stays_fallen():
                self._trial.why = "the robot fell without a fault"
                return None
        return self._judge()

    def _period(self) -> None:
        self.publish_state()
        if self.time >= self._pauses_at:
            self._paused_until = self.time + _between(self._rng, _PAUSE_DURATION)
            self._pauses_at = self._paused_until + _between(self._rng, _TIME_BETWEEN_PAUSES)
        if self.time >= self._paused_until:
            self.loop.run_due(self.monitor.now)
        self.mock.advance()

    def _judge(self) -> None:
        if self.monitor.deactivation is not None:
            self._trial.result = self.monitor.deactivation[1]
        violations = dict(self.monitor.violations)
        if any(fault.place == "stamps and clock" for fault in self._faults):
            violations.pop("stale", None)
        if violations:
            name, sentence = next(iter(violations.items()))
            self._trial.why = f"{name}: {sentence}"


def _between(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def summary(trials: Sequence[ClockTrial]) -> Iterator[str]:
    """Yield a line for each robot and clock, and for each violation."""
    for robot, clock in dict.fromkeys((trial.robot, trial.clock) for trial in trials):
        own = [trial.result for trial in trials if (trial.robot, trial.clock) == (robot, clock)]
        yield f"{robot:10} {clock:13} " + ", ".join(f"{own.count(each)} {each}" for each in sorted(set(own)))
    yield from (str(trial) for trial in trials if trial.why)
