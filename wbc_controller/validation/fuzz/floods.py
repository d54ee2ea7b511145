"""Floods: another participant fills an input of the controller, and an emergency stop has to pass."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, WbcError, valid_choices
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.topics import Endpoint, counterpart
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.recording.cycle_arrays import cycle_arrays
from wbc_controller.recording.recording_file import Recording
from wbc_controller.validation.fuzz import DOMAIN
from wbc_controller.validation.fuzz.contents import ordinary
from wbc_controller.validation.fuzz.rig import MACHINE, Rig

#: Messages per second of a flood, and of one whose messages are large.
_RATE, _SLOW_RATE = 10_000.0, 20.0
#: Time in which the controller finds the participant of a flood, s.
_DISCOVERY = 0.2
#: Length of a large text, in characters.
_LARGE = 10_000_000
#: Points of a trajectory.
_POINTS = 100
#: Time of a flood before and after the stop, s.
_BEFORE, _AFTER = (0.2, 0.6), 0.15
#: Time after a flood in which a busy machine may still bring the diagnostics of it, s.
_TOLD = 2.0
#: Trials for each stop that is counted, at most: where the machine stalls, another fault comes before the stop.
_ATTEMPTS = 5
#: Changes of settings: what is measured is the stop, and a machine that is late must not end in another fault first.
_CHANGES = {"safety.activation_ramp": 0.1, "safety.state_timeout": 0.3}
#: Cycles within which a stop is obeyed, counted from the newest state that its sender knew when it was sent.
CYCLES = 2
#: Longest cycle, beside the lateness of the machine, s.
STALL = 0.02


def _string(text: str) -> Callable[[Rig], bytes]:
    return lambda rig: encode(message("std_msgs/msg/String", data=text))


def _trajectory(rig: Rig) -> bytes:
    content = ordinary("trajectory_msgs/msg/MultiDOFJointTrajectory", (), "world", 0)
    point = content.points[0]
    content.points = [
        message(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            transforms=point.transforms,
            velocities=[],
            accelerations=[],
            time_from_start=message("builtin_interfaces/msg/Duration", sec=i + 1, nanosec=0),
        )
        for i in range(_POINTS)
    ]
    return encode(content)


def _setpoint(rig: Rig) -> bytes:
    return encode(ordinary("geometry_msgs/msg/PointStamped", (), "world", 0))


#: The floods: the input, and the message.
FLOODS: Mapping[str, tuple[str, Callable[[Rig], bytes]]] = {
    "activate": ("command", _string("activate")),
    "garbage": ("command", _string("\x7f%s{}é\n" * 30)),
    "setpoint": ("setpoint/com", _setpoint),
    "trajectory": ("trajectory/com", _trajectory),
    "update": ("update", _string("{tasks: {com: {stiffness: 101.0}}}")),
    "nonsense": ("update", _string("{tasks: {com: {stiffness: [" + "1, " * 1000 + "]}}}")),
    "odometry": ("odom", lambda rig: encode(ordinary("nav_msgs/msg/Odometry", (), "world", 1))),
    "joint_states": ("joint_states", lambda rig: encode(ordinary("sensor_msgs/msg/JointState", ("nose",), "", 1))),
    "large": ("update", _string("x" * _LARGE)),
}


@dataclass(frozen=True, slots=True)
class StopTrial:
    """One emergency stop under a flood.

    Attributes:
        flood: key of the flood.
        cycles: cycles after the newest state that the sender knew, up to the first one in the controller's record with
            zero torques and the fault, those that lack in the record meanwhile too.
        seen: time from sending until the sender saw the zero torques, s.
        slowest: longest cycle in the record while the flood lasted, s.
        late: lateness of the machine meanwhile, s.
        sent: messages of the flood.
        rate: of the flood, messages per second.
        said: whether the diagnostics said that messages were lost or refused.
        period: of the controller, s.
    """

    flood: str
    cycles: int
    seen: float
    slowest: float
    late: float
    sent: int
    rate: float
    said: bool
    period: float

    @property
    def obeyed(self) -> bool:
        """Whether the stop was obeyed within `CYCLES`, beside those for which the machine was late."""
        return self.cycles <= CYCLES + math.ceil(2.0 * self.late / self.period)

    @property
    def steady(self) -> bool:
        """Whether no cycle took longer than `STALL`, beside the lateness of the machine."""
        return self.slowest <= STALL + 2.0 * self.late


def flood(kind: str, topic: Endpoint, payload: bytes, domain: int, running: Any, count: Any) -> None:
    """Send a message again and again, in a process of its own, while an event is set.

    Args:
        kind: key in `FLOODS`.
        topic: the input.
        payload: the message.
        domain: DDS domain.
        running: event while which it sends.
        count: shared number of messages; negative to end the process.
    """
    rate = _SLOW_RATE if kind == "large" else _RATE
    count.value = 0
    while count.value >= 0:
        if not running.wait(0.1):
            continue
        # It comes and goes: a participant that stayed would be a rival to the robot's odometry, which none may be.
        transport = DdsTransport(f"flood_{kind}", domain_id=domain, discovery_range="LOCALHOST")
        publish = transport.advertise(counterpart(topic))
        time.sleep(_DISCOVERY)
        began, sent = time.monotonic(), 0
        while running.is_set():
            due = (time.monotonic() - began) * rate
            while sent < due and running.is_set():
                publish(payload)
                sent += 1
                count.value += 1
            time.sleep(0.0005)
        transport.close()


def _ready(count: Any) -> bool:
    return bool(count.value == 0)


def flood_trials(
    robot: str,
    folder: Path,
    trials: int,
    *,
    kinds: Sequence[str] = tuple(FLOODS),
    domain: int = DOMAIN,
    seed: int = 0,
    progress: Callable[[StopTrial], None] = lambda trial: None,
) -> list[StopTrial]:
    """Flood each kind of input of a running controller, and stop it in the middle, again and again.

    Args:
        robot: a robot that is shipped, or the path of a configuration.
        folder: for logs and records.
        trials: stops per flood.
        kinds: keys of the floods in `FLOODS`.
        domain: DDS domain.
        seed: of the moments.
        progress: called after each trial.

    Raises:
        ConfigurationError: if there is no such flood.
        WbcError: if a process does not do what it should.
    """
    for kind in kinds:
        if kind not in FLOODS:
            raise ConfigurationError(f"no flood is named {kind!r}; {valid_choices(kind, FLOODS)}")
    rng, done = np.random.default_rng(seed), []
    with Rig(robot, folder, domain, _CHANGES) as rig:
        rig.start("mock")
        for kind in kinds:
            for trial in _under_one_flood(rig, kind, trials, rng, domain):
                done.append(trial)
                progress(trial)
    return done


def _under_one_flood(rig: Rig, kind: str, trials: int, rng: np.random.Generator, domain: int) -> list[StopTrial]:
    """The trials of one flood, with a controller of its own, whose record says what it did."""
    context = multiprocessing.get_context("spawn")
    running, count = context.Event(), context.Value("q", -1)
    name, make = FLOODS[kind]
    flooder = context.Process(
        target=flood, args=(kind, rig.inputs[name], make(rig), domain, running, count), daemon=True
    )
    rig.forget("controller")
    rig.record.unlink(missing_ok=True)
    rig.start("controller", "--record", str(rig.record))
    flooder.start()
    try:
        rig.wait_for("mock", "controller")
        rig.until(partial(_ready, count), "the flooder")
        stops: list[_Stop] = []
        for _ in range(_ATTEMPTS * trials):
            stop = _stop_once(rig, running, count, float(rng.uniform(*_BEFORE)))
            stops += [stop] if stop is not None else []
            if len(stops) == trials:
                break
        else:
            raise WbcError(f"the machine was too late for {trials} stops under the flood {kind!r}")
    finally:
        count.value = -(2**62)  # ends it
        flooder.join(5.0)
        flooder.kill()
    status = rig.stop("controller")
    if status != 0 or not rig.record.exists():
        raise WbcError(f"the controller ended with exit status {status} after the flood {kind!r}")
    recorded = Recording(rig.record)
    gaps, record = _gaps(recorded), cycle_arrays(recorded)
    stamps, modes, totals = record["stamp"], record["mode"], record["seconds/total"]
    stopped = ~record["tau"].any(axis=1) & (modes == "fault")
    found, period = [], 1.0 / rig.settings.control.rate
    for stop in stops:
        after = stamps > stop.known
        obeyed = np.flatnonzero(after & stopped)
        most = math.ceil(stop.seen / period) + 1  # its sender waited no longer for the zero torques
        if len(obeyed):
            lost = sum(count for start, end, count in gaps if end > stop.known and start < stamps[obeyed[0]])
            cycles = int(after[: obeyed[0] + 1].sum()) + min(lost, most)
        else:  # the record lacks all that followed
            cycles = most
        found.append(
            StopTrial(
                flood=kind,
                cycles=cycles,
                seen=stop.seen,
                slowest=float(totals[(stamps >= stop.began) & (stamps <= stop.ended)].max(initial=0.0)),
                late=stop.late,
                sent=stop.sent,
                rate=stop.sent / stop.seconds,
                said=stop.said,
                period=period,
            )
        )
    return found


def _gaps(recorded: Recording) -> list[tuple[int, int, int]]:
    """Where cycles lack in a recording: stamps of the cycles before and after, ns, and how many lack."""
    known = [(each.number, each.stamp) for each in recorded.cycles()]
    return [
        (before, stamp, number - last - 1) for (last, before), (number, stamp) in pairwise(known) if number > last + 1
    ]


@dataclass(frozen=True, slots=True)
class _Stop:
    """What the sender of a stop knows: stamps of the robot's states in ns, and times in s."""

    began: int
    known: int
    ended: int
    seen: float
    late: float
    sent: int
    seconds: float
    said: bool


def _stop_once(rig: Rig, running: Any, count: Any, before: float) -> _Stop | None:
    """Activate, flood, and stop; None where the machine was so late that another fault came before.

    Raises:
        WbcError: where another fault came and the machine was not late.
    """
    rig.activate()
    rig.until(lambda: bool(rig.efforts(time.monotonic() - 0.05)[1].any()), "torques")
    rig.lateness.forget()
    count.value = 0
    running.set()
    rig.until(lambda: count.value > 0, "the first message of the flood")
    began, start = time.monotonic(), rig.stamp()
    time.sleep(before)
    known = rig.stamp()
    sent_at = rig.command("estop")
    rig.until(lambda: rig.said("controller").startswith("fault"), "the stop", patience=60.0)
    time.sleep(_AFTER)
    running.clear()
    if "ESTOP" not in (fault := rig.said("controller")):
        if rig.lateness.worst < MACHINE * rig.settings.safety.state_timeout:
            raise WbcError(f"before the stop came {fault!r}, and the machine was {rig.lateness.worst:.3f} s late")
        return None
    seconds = time.monotonic() - began
    late, sent = rig.lateness.worst, count.value
    times, torques = rig.efforts(sent_at)
    said, told = False, time.monotonic() + _TOLD
    while not said and time.monotonic() < told:
        said = any(
            entry.key.startswith("refused") for _, content in rig.heard("controller/diagnostics", began)
            for entry in content.status[0].values
        )  # fmt: skip
        time.sleep(0.02)
    seen = float(times[~torques.any(axis=1)][0] - sent_at)
    return _Stop(start, known, rig.stamp(), seen, late, sent, seconds, said)
