"""One trial: a robot that stands and moves, a fault at a random moment, and what came of it.

Controller, physics and user run in one thread on simulated time, so that the same seed gives the same trial. Their
clocks are the same one; trials with an odd seed tell the controller so (`safety.synchronized_clocks`), in the others it
has to learn the offset.
"""

from __future__ import annotations

import contextlib
import gc
import math
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, WbcError, valid_choices
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.simulated_clock import clock_of
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.recording.recorder import Recorder
from wbc_controller.records import Mode
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.catalogue import KINDS, draw
from wbc_controller.simulation.faults.fault import Fault
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.validation.campaign.body import Body
from wbc_controller.validation.campaign.expectations import Expectation, expect
from wbc_controller.validation.campaign.outcome import UNSEEN, Outcome
from wbc_controller.validation.campaign.recordings import Place
from wbc_controller.validation.campaign.user import User
from wbc_controller.validation.campaign.user_faults import USER_KINDS, UserFault
from wbc_controller.validation.campaign.watch import Watch
from wbc_controller.validation.error_log import logged_errors

#: Every kind of fault that a trial can have, by name.
ALL_KINDS: Mapping[str, type[Fault]] = {**KINDS, **USER_KINDS}
#: Kinds for which the controller measures time by /clock.
_BY_CLOCK = ("clock_jump", "clock_frozen", "clock_drift")
#: Earliest and latest beginning of a fault after the robot has begun to move, and shortest and longest duration, s.
_BEGINS, _LASTS = (0.2, 0.5), (0.05, 0.6)
#: How long a trial goes on after the fault, and after the controller has left its active mode, s.
_AFTER, _DAMPED = 0.6, 0.2
#: Time between two looks at the whole robot, s.
_LOOK = 0.01
#: Periods for which the base is held before anything else.
_HELD = 3


def run_trial(
    robot: str,
    kind: str,
    seed: int,
    *,
    parameters: Mapping[str, Any] | None = None,
    prepare: Callable[[Controller], None] = lambda controller: None,
    recordings: Path | None = None,
) -> Outcome:
    """Run one trial.

    Args:
        robot: a shipped robot's name, or the path of a configuration.
        kind: kind of the fault.
        seed: decides when the fault begins, how long it lasts, and its parameters.
        parameters: of the fault, in place of those that are drawn.
        prepare: called with the controller before the trial, for tests.
        recordings: folder for the recording that a fault leaves, which then has to name the fault, and to come out bit
            for bit when it is solved again; None records nothing.

    Raises:
        ConfigurationError: where the kind is unknown, or the configuration cannot be used.
    """
    began = time.perf_counter()
    if kind not in ALL_KINDS:
        raise ConfigurationError(f"kind {kind!r} is unknown; {valid_choices(kind, ALL_KINDS)}")
    rng = np.random.default_rng([seed, zlib.crc32(f"{robot}/{kind}".encode())])
    given = {
        "start": rng.uniform(*_BEGINS),
        "duration": rng.uniform(*_LASTS),
        "seed": int(rng.integers(2**32)),
        **(parameters or {}),
    }
    fault = draw(ALL_KINDS[kind], rng, **given)
    place = None if recordings is None else Place(recordings, f"{Path(robot).stem}-{kind}-{seed}")
    if place is not None:
        place.clear()
    with logged_errors() as logged, np.errstate(all="ignore"):  # absurd values overflow before they are refused
        trial = _Trial(robot, fault, prepare, rng, place, synchronized=seed % 2 == 1)
        with _few_objects_to_collect():
            trial.run()
        if place is not None:
            trial.look_at(place)
    if logged:
        trial.watch.found("logged", logged[0])
    return trial.outcome(robot, seed, time.perf_counter() - began)


class _Trial:
    """The robot, its controller and its user on one bus, and what is seen of them."""

    def __init__(
        self,
        robot: str,
        fault: Fault,
        prepare: Callable[[Controller], None],
        rng: np.random.Generator,
        place: Place | None,
        *,
        synchronized: bool,
    ) -> None:
        changes = {
            **(place.settings if place is not None else {}),
            "safety.activation_ramp": 0.0,
            "safety.synchronized_clocks": synchronized,
            "control.markers_rate": 0.0,
            "control.trigger": "joint_states",
        }
        settings = load(robot).replace(changes).settings
        model = make_model(settings)
        topics = controller_endpoints(settings, model)
        bus = MemoryBus()
        names = {topic.key: topic.name for topic in topics if topic.key in ("joint_states", "odom")}
        if not model.floating_base:
            del names["odom"]
        self.watch = Watch(model, settings, names, stamps_lie=fault.place == "stamps and clock")
        self._fault = fault
        self._expected = expect(fault, settings)
        self._settings = settings
        self._period = 1.0 / settings.control.rate
        self._robot = MockRobot(model, settings, MemoryTransport(bus))
        self._robot.sent = self.watch.sent
        controller = Controller(settings, preflight=False, model=model)
        prepare(controller)
        transport = MemoryTransport(bus)
        self._recorder = None if place is None else Recorder(settings, patient=True, name=place.name)
        self._manual = ManualClock()
        self._read = 0.0  # processor time of reading in the last cycle, which a thread of its own does in a service
        self._loop = make_loop(
            controller,
            transport,
            clock_of(topics, transport) if fault.kind() in _BY_CLOCK else self._manual,
            topics,
            timer=time.thread_time,
            observers=(self.watch.cycle, lambda report: setattr(self, "_read", report.stage_seconds["read"])),
            recorder=self._recorder,
        )
        user_transport = MemoryTransport(bus)
        self._user = User(settings, model, topics, user_transport)
        effort = next(topic for topic in topics if topic.key == "effort")
        user_transport.subscribe(counterpart(effort), self.watch.torques)
        self._body = Body(model, self._robot.plant)
        self._act = fault.act(self._user, rng) if isinstance(fault, UserFault) else None
        self._began = math.inf  # of the fault, on the watch's time
        self._simulated = 0.0
        self._moved = 0.0

    def run(self) -> None:
        """Stand up, move, let the fault happen, and see what comes of it."""
        try:
            self._stand()
            if self.watch.mode is not Mode.ACTIVE or self._body.fallen():
                self.watch.found("start", f"mode {self.watch.mode}")
                return
            self._user.move(self._body.com())
            plant = self._robot.plant
            begins = plant.time + self._fault.start
            self._began = 1.0e-9 * self._robot.stamp + self._fault.start
            if self._act is None:
                self._robot.plan([self._fault], since=plant.time)
            self._go_on(begins, begins + self._fault.duration)
        except WbcError as error:
            self.watch.found("diverged", str(error))
        finally:
            self._simulated = self._robot.plant.time
            if self._recorder is not None:
                self._recorder.close()

    def look_at(self, place: Place) -> None:
        """See whether the recording that a fault has left names it, and comes out again."""
        left = self.watch.left
        if left is not None and left[2]:
            lacks = place.lacks(left[1], left[2])
            if lacks:
                self.watch.found("recording", lacks)

    def _stand(self) -> None:
        """Activate with the base held until the torques are those of standing, and let it go."""
        for _ in range(_HELD):
            self._cycle()
        self._user.say("command", "activate")
        rising = 1.0 / self._settings.limits.torque_rate
        for _ in range(_HELD + math.ceil(rising / self._period)):
            self._cycle()
        self._robot.plant.hold(False, ramp=0.0)
        for _ in range(_HELD):
            self._cycle()

    def _go_on(self, begins: float, ends: float) -> None:
        """Let the time of the fault come and pass."""
        plant, looked, fallen_since, origin = self._robot.plant, -math.inf, math.inf, self._body.com()
        while plant.time < ends + _AFTER:
            now = plant.time
            if now - looked >= _LOOK:
                looked, com = now, self._body.com()
                if now < begins:
                    origin = com
                self._moved = max(self._moved, float(np.linalg.norm(com - origin)))
                if not self._body.fallen():
                    fallen_since = math.inf
                elif self.watch.left is None:
                    fallen_since = min(fallen_since, now)
                    if now - fallen_since > UNSEEN:
                        self.watch.found("fell", f"the mode is {self.watch.mode.value if self.watch.mode else ''}")
            if self.watch.left is not None and now > self.watch.left[0] + _DAMPED:
                return
            if self._act is not None and begins - 1e-9 <= now < ends:
                self._act(self._body.com())
            self._cycle()

    def _cycle(self) -> None:
        """One control period: measure, compute where a cycle is due, act."""
        self.watch.now = self._manual.time = 1.0e-9 * self._robot.stamp
        self._robot.publish()
        before = time.thread_time()
        # The first cycles of a process take longer: code is made when it is first used.
        if self._loop.run_due(self.watch.now, self._period) and self.watch.now >= self._began:
            self.watch.spent(time.thread_time() - before - self._read)
        self._robot.advance()

    def outcome(self, robot: str, seed: int, wall: float) -> Outcome:
        """Judge what has been seen."""
        watch, expected = self.watch, self._expected
        left = watch.left
        after = left[0] - self._began if left is not None and math.isfinite(self._began) else None
        if "start" not in watch.violations and "diverged" not in watch.violations:
            self._judge(expected, after, left[1] if left is not None else "")
        result = "violation" if watch.violations else "survived" if left is None else "damped"
        keys = [key for key in self._fault.model_fields_set if key not in ("start", "seed")]
        return Outcome(
            robot,
            self._fault.kind(),
            seed,
            {key: getattr(self._fault, key) for key in sorted(keys)},
            expected.word,
            expected.deadline,
            result,
            left[1] if left is not None else "",
            left[2] if left is not None else "",
            after,
            self._moved,
            watch.longest,
            self._simulated,
            wall,
            dict(watch.violations),
        )

    def _judge(self, expected: Expectation, after: float | None, code: str) -> None:
        """Compare what came of the fault with what had to."""
        if after is not None and after < 0.0:
            self.watch.found("early", f"{code} {-after:.3f} s before the fault")
        elif after is not None and code not in expected.codes:
            valid = ", ".join(sorted(expected.codes)) or "none, as this fault is harmless"
            self.watch.found("wrong_reason", f"{code}; valid: {valid}")
        elif expected.deadline is not None and not (after is not None and after <= expected.deadline + 1e-9):
            came = f"detected after {after:.4f} s" if after is not None else "not detected"
            self.watch.found("undetected", f"{came}; it has to be within {expected.deadline:.4f} s")


@contextlib.contextmanager
def _few_objects_to_collect() -> Iterator[None]:
    """Keep garbage collections as short as the service's loop does, which freezes what it starts with."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
