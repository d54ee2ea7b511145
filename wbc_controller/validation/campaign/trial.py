"""One trial: a standing or walking robot, a fault, the outcome, and the check of its recordings.

Controller, physics and user run in one thread on simulated time. Odd seeds set `safety.synchronized_clocks`; with even
seeds the controller learns the offset of its clock.
"""

import gc
import math
import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, WbcError, require_known
from wbc_controller.middleware.codec import velocity_message
from wbc_controller.recording.recorder import Recorder
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.replay.recording_summary import summarize
from wbc_controller.records import Mode
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.catalogue import KINDS, draw
from wbc_controller.simulation.faults.fault import Fault
from wbc_controller.validation.campaign.expectations import expect
from wbc_controller.validation.campaign.monitor import MonitoredRobot, logged_errors
from wbc_controller.validation.campaign.request_faults import REQUEST_KINDS, RequestFault, RequestFaultState
from wbc_controller.validation.campaign.results import Outcome
from wbc_controller.walking.gait import Phase

ALL_KINDS: Mapping[str, type[Fault]] = {**KINDS, **REQUEST_KINDS}
_BY_CLOCK = ("clock_jump", "clock_frozen", "clock_drift")  # kinds with a controller on the time of /clock
#: Ranges of the fault's start after the beginning of the motion, and of its duration, s.
_START_RANGE, _DURATION_RANGE = (0.2, 0.5), (0.05, 0.6)
_AFTER_FAULT, _AFTER_DAMPING = 0.6, 0.2  # after the fault, and after the active mode, s
_CHECK_PERIOD = 0.01  # s
_HOLD_PERIODS = 3
#: Walking: speed, m/s, period of commands, s, steps before the fault, and their time limit, s.
WALK_SPEED, _COMMAND_PERIOD, _STEPS, _WALK_TIMEOUT = 0.25, 0.1, 2, 8.0


@dataclass(frozen=True, slots=True)
class TrialRecordings:
    """Recordings of one trial: each names its fault, and its replay is identical."""

    folder: Path
    name: str  # beginning of the file names

    def error_of_fault(self, code: str, sentence: str) -> str:
        """Return the error of a fault's recording, or an empty text."""
        files = self.files()
        if not files:
            return f"no recording of {code}"
        try:
            found = [Recording(file) for file in files]
            named = [each for each in found if f"fault {code} " in (said := summarize(each)) and sentence in said]
            if not named:
                return f"{files[-1]} does not name {code}"
            with np.errstate(all="ignore"):
                cycles = list(Replay(named[0]).run())
        except ConfigurationError as error:
            return str(error)
        different = sum(not each.is_identical for each in cycles)
        if different or not cycles:
            return f"{named[0].path}: the replay of {different} of {len(cycles)} cycles differs from the recording"
        return ""

    def files(self) -> list[Path]:
        """Return the recordings, sorted by name."""
        return sorted(self.folder.glob(f"{self.name}-[0-9]*-[0-9]*-*.mcap"))


def run_trial(
    robot: str,
    kind: str,
    seed: int,
    walking: bool = False,
    *,
    parameters: Mapping[str, Any] | None = None,
    prepare: Callable[[Controller], None] = lambda controller: None,
    recordings: Path | None = None,
) -> Outcome:
    """Run one trial; the seed determines start, duration and parameters of the fault.

    Raises `ConfigurationError` if the kind is unknown or the configuration invalid.

    Args:
        walking: the fault starts during a step; else the robot sways.
        parameters: of the fault, in place of random ones.
        prepare: for tests.
        recordings: folder of checked fault recordings.
    """
    require_known(kind, ALL_KINDS, "unknown kind of fault")
    rng = np.random.default_rng([seed, zlib.crc32(f"{robot}/{kind}".encode())])
    times = {"start": rng.uniform(*_START_RANGE), "duration": rng.uniform(*_DURATION_RANGE)}
    fault = draw(ALL_KINDS[kind], rng, **{**times, "seed": int(rng.integers(2**32)), **(parameters or {})})
    place = None if recordings is None else TrialRecordings(recordings, f"{Path(robot).stem}-{kind}-{seed}")
    for file in place.files() if place is not None else ():  # of an earlier run
        file.unlink()
    with logged_errors() as logged, np.errstate(all="ignore"):  # absurd values overflow before their refusal
        trial = _Trial(robot, seed, fault, rng, place, walking)
        prepare(trial.controller)
        gc.collect()
        gc.freeze()
        try:
            trial.run()
        finally:
            gc.unfreeze()
        if place is not None and (deactivation := trial.monitor.deactivation) is not None and deactivation[2]:
            error = place.error_of_fault(deactivation[1], deactivation[2])
            if error:
                trial.monitor.add_violation("recording", error)
    if logged:
        trial.monitor.add_violation("logged", logged[0])
    return trial.outcome(robot, seed)


class _Trial(MonitoredRobot):
    def __init__(
        self, robot: str, seed: int, fault: Fault, rng: np.random.Generator, place: TrialRecordings | None, walks: bool
    ) -> None:
        changes = {
            **({} if place is None else {"recorder.folder": str(place.folder.absolute())}),
            "safety.activation_ramp": 0.0,
            "safety.bring_up_time": 0.0,
            "safety.synchronized_clocks": seed % 2 == 1,
            "control.markers_rate": 0.0,
            "control.trigger": "joint_states",
        }
        settings = load(robot).replace(changes).settings
        self._recorder = None if place is None else Recorder(settings, patient=True, name=place.name)
        self._read = 0.0
        super().__init__(
            settings,
            lambda report: setattr(self, "_read", report.stage_seconds["read"]),
            stamps_lie=fault.place == "stamps and clock",
            use_sim_time=fault.kind() in _BY_CLOCK,
            timer=time.thread_time,
            recorder=self._recorder,
        )
        if walks and self.controller.walker is None:
            raise ConfigurationError(f"{robot} cannot walk: its configuration has no section 'walking'")
        self._walking, self._commanded = walks, math.inf  # time of the next velocity, s
        self._fault, self._expected = fault, expect(fault, settings)
        self._request_state = RequestFaultState(self.user, rng)
        self._began = math.inf  # start of the fault on the monitor's time
        self._moved = 0.0

    def run(self) -> None:
        try:
            self._stand()
            if self.monitor.mode is not Mode.ACTIVE or self.has_fallen():
                self.monitor.add_violation("start", f"mode {self.monitor.mode}")
                return
            self._walk() if self._walking else self.user.move(self.com())
            plant = self.mock.plant
            begins = plant.time + self._fault.start
            self._began = 1.0e-9 * self.mock.stamp + self._fault.start
            if not isinstance(self._fault, RequestFault):
                self.mock.plan([self._fault], since=plant.time)
            self._run_fault(begins, begins + self._fault.duration)
        except WbcError as error:
            self.monitor.add_violation("diverged", str(error))
        finally:
            if self._recorder is not None:
                self._recorder.close()

    def _stand(self) -> None:
        for _ in range(_HOLD_PERIODS):
            self._cycle()
        self.user.send_text("command", "activate")
        rising = 1.0 / self.settings.limits.torque_rate
        for _ in range(_HOLD_PERIODS + math.ceil(rising / self.controller.period)):
            self._cycle()
        self.mock.plant.hold(False, ramp=0.0)
        for _ in range(_HOLD_PERIODS):
            self._cycle()

    def _walk(self) -> None:
        walker, latest = self.controller.walker, self.mock.plant.time + _WALK_TIMEOUT
        self._commanded = self.mock.plant.time
        while walker is not None and not (walker.steps >= _STEPS and walker.phase is Phase.SINGLE):
            self._cycle()
            if self.mock.plant.time > latest or self.monitor.mode is not Mode.ACTIVE:
                self.monitor.add_violation("start", f"mode {self.monitor.mode}, {walker.steps} steps")
                return

    def _run_fault(self, begins: float, ends: float) -> None:
        plant, checked_at, origin = self.mock.plant, -math.inf, self.com()
        while plant.time < ends + _AFTER_FAULT:
            now = plant.time
            if now - checked_at >= _CHECK_PERIOD:
                checked_at, com = now, self.com()
                if now < begins:
                    origin = com
                self._moved = max(self._moved, float(np.linalg.norm(com - origin)))
                if self.stays_fallen() and self.monitor.deactivation is None:
                    self.monitor.add_violation("fell", f"mode {self.monitor.mode.value if self.monitor.mode else ''}")
            if self.monitor.deactivation is not None and now > self.monitor.deactivation[0] + _AFTER_DAMPING:
                return
            if isinstance(self._fault, RequestFault) and begins - 1e-9 <= now < ends:
                self._fault.step(self._request_state, self.com())
            self._cycle()

    def _cycle(self) -> None:
        if self.mock.plant.time >= self._commanded:
            self._commanded += _COMMAND_PERIOD
            self.user.send("cmd_vel", velocity_message((WALK_SPEED, 0.0, 0.0)))
        self.publish_state()
        before = time.thread_time()
        if self.loop.run_due(self.monitor.now) and self.monitor.now >= self._began:
            self.monitor.check_processor_time(time.thread_time() - before - self._read)
        self.mock.advance()

    def outcome(self, robot: str, seed: int) -> Outcome:
        monitor = self.monitor
        when, code, sentence = monitor.deactivation or (None, "", "")
        after = when - self._began if when is not None and math.isfinite(self._began) else None
        if "start" not in monitor.violations and "diverged" not in monitor.violations:
            self._judge(after, code)
        keys = sorted(key for key in self._fault.model_fields_set if key not in ("start", "seed"))
        return Outcome(
            robot=robot,
            kind=self._fault.kind(),
            seed=seed,
            parameters={key: getattr(self._fault, key) for key in keys},
            deadline=self._expected.deadline,
            result="violation" if monitor.violations else "survived" if when is None else "damped",
            code=code,
            sentence=sentence,
            after=after,
            moved=self._moved,
            longest=monitor.longest,
            violations=dict(monitor.violations),
            walking=self._walking,
        )

    def _judge(self, after: float | None, code: str) -> None:
        expected = self._expected
        if after is not None and after < 0.0:
            self.monitor.add_violation("early", f"{code} {-after:.3f} s before the fault")
        elif after is not None and code not in expected.codes:
            valid = ", ".join(sorted(expected.codes)) or "none, because this fault is harmless"
            self.monitor.add_violation("wrong_reason", f"{code}; valid: {valid}")
        elif expected.deadline is not None and not (after is not None and after <= expected.deadline + 1e-9):
            came = f"detected after {after:.4f} s" if after is not None else "not detected"
            self.monitor.add_violation("undetected", f"{came}; required: within {expected.deadline:.4f} s")
