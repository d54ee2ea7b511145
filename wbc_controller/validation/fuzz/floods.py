"""Floods of one input; an emergency stop must pass."""

import math
import multiprocessing
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import WbcError, require_known
from wbc_controller.middleware.codec import com_trajectory, encode, message
from wbc_controller.middleware.topics import Endpoint, counterpart
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.recording.recording_file import Recording
from wbc_controller.validation.fuzz.robot_processes import MACHINE, RobotProcesses
from wbc_controller.validation.fuzz.target import valid_message

_RATE, _SLOW_RATE = 10_000.0, 20.0  # messages per second; second value for large messages
_DISCOVERY_TIME = 0.2  # s
_TIME_BEFORE_STOP, _TIME_AFTER_STOP = (0.2, 0.6), 0.15  # duration before and after the stop, s
_DIAGNOSTICS_TIMEOUT = 2.0  # s
_ATTEMPTS = 5  # per counted stop; stalls of the machine may cause another fault
#: Settings that prevent other faults on a slow machine.
_CHANGES = {"safety.activation_ramp": 0.1, "safety.state_timeout": 0.3}
CYCLES = 2  # until a stop is obeyed, from the newest state known to its sender
STALL = 0.02  # longest cycle, s


#: Input of each flood, and its text or message.
FLOODS: Mapping[str, tuple[str, Any]] = {
    "activate": ("command", "activate"),
    "garbage": ("command", "\x7f%s{}é\n" * 30),
    "setpoint": ("setpoint/com", valid_message("geometry_msgs/msg/PointStamped", (), "world", 0)),
    "trajectory": ("trajectory/com", com_trajectory(range(1, 101), np.tile([0.0, 0.0, 1.0], (100, 1)))),
    "update": ("update", "{tasks: {com: {stiffness: 101.0}}}"),
    "nonsense": ("update", "{tasks: {com: {stiffness: [" + "1, " * 1000 + "]}}}"),
    "odometry": ("odom", valid_message("nav_msgs/msg/Odometry", (), "world", 1)),
    "joint_states": ("joint_states", valid_message("sensor_msgs/msg/JointState", ("nose",), "", 1)),
    "large": ("update", "x" * 10_000_000),
}


@dataclass(frozen=True, slots=True)
class Stop:
    """An emergency stop from its sender's view."""

    began: int  # stamp at the beginning of the flood, ns
    known: int  # newest stamp known to the sender at the stop, ns
    ended: int  # stamp at the end, ns
    delay: float  # time from sending to the arrival of zero torques, s
    late: float  # s
    sent: int
    seconds: float
    losses_reported: bool  # by the diagnostics


@dataclass(frozen=True, slots=True)
class StopTrial:
    """An emergency stop under a flood, with the controller's record of it."""

    flood: str
    stop: Stop
    cycles: int  # from the newest state known to the sender to zero torques and the fault, with unrecorded cycles
    slowest: float  # s
    period: float

    @property
    def rate(self) -> float:
        """Messages of the flood per second."""
        return self.stop.sent / self.stop.seconds

    @property
    def obeyed(self) -> bool:
        """True if the stop was obeyed within `CYCLES`, plus the lateness of the machine."""
        return self.cycles <= CYCLES + math.ceil(2.0 * self.stop.late / self.period)

    @property
    def steady(self) -> bool:
        """True if no cycle exceeded `STALL`, plus the lateness of the machine."""
        return self.slowest <= STALL + 2.0 * self.stop.late

    @property
    def failed(self) -> bool:
        """True if the stop was late, or a cycle too long."""
        return not (self.obeyed and self.steady)


def flood(kind: str, topic: Endpoint, payload: bytes, domain: int, running: Any, count: Any) -> None:
    """Send a message while an event is set; a negative count ends the process."""
    end_with_parent()
    rate = _SLOW_RATE if kind == "large" else _RATE
    count.value = 0
    while count.value >= 0:
        if not running.wait(0.1):
            continue
        # Temporary: a permanent participant would be a second publisher of the odometry.
        transport = DdsTransport(f"flood_{kind}", domain_id=domain, discovery_range="LOCALHOST")
        publish = transport.advertise(counterpart(topic))
        time.sleep(_DISCOVERY_TIME)
        began, sent = time.monotonic(), 0
        while running.is_set():
            due = (time.monotonic() - began) * rate
            while sent < due and running.is_set():
                publish(payload)
                sent += 1
                count.value += 1
            time.sleep(0.0005)
        transport.close()


def flood_trials(
    robot: str, folder: Path, trials: int, *, kinds: Sequence[str], domain: int, seed: int = 0
) -> Iterator[StopTrial]:
    """Flood each kind of input of a running controller, and stop it; raise `WbcError` if a process fails."""
    require_known(kinds, FLOODS, "unknown flood")
    rng = np.random.default_rng(seed)
    with RobotProcesses(robot, folder, domain, _CHANGES) as nodes:
        nodes.start("mock")
        for kind in kinds:
            yield from _under_one_flood(nodes, kind, trials, rng, domain)


def summary(trials: Sequence[StopTrial]) -> Iterator[str]:
    """Yield a line for each kind of flood."""
    for kind in dict.fromkeys(trial.flood for trial in trials):
        own = [trial for trial in trials if trial.flood == kind]
        rates, cycles = [trial.rate for trial in own], max(trial.cycles for trial in own)
        delay, slowest = 1e3 * max(trial.stop.delay for trial in own), 1e3 * max(trial.slowest for trial in own)
        yield (
            f"{kind:14} at {min(rates):.0f} to {max(rates):.0f} messages/s: obeyed within {CYCLES} cycles in "
            f"{sum(t.obeyed for t in own)} of {len(own)} (max. {cycles}), zero torques within {delay:.1f} ms; "
            f"slowest cycle {slowest:.1f} ms, steady in {sum(t.steady for t in own)}; losses reported in "
            f"{sum(t.stop.losses_reported for t in own)}"
        )


def _under_one_flood(
    nodes: RobotProcesses, kind: str, trials: int, rng: np.random.Generator, domain: int
) -> list[StopTrial]:
    context = multiprocessing.get_context("spawn")
    running, count = context.Event(), context.Value("q", -1)
    name, content = FLOODS[kind]
    topic = nodes.inputs[name]
    payload = encode(message(topic.type, data=content) if isinstance(content, str) else content)
    flooder = context.Process(target=flood, args=(kind, topic, payload, domain, running, count), daemon=True)
    nodes.clear("controller")
    nodes.record.unlink(missing_ok=True)
    nodes.start("controller", "--record", str(nodes.record))
    flooder.start()
    try:
        nodes.wait_for("mock", "controller")
        nodes.until(lambda: bool(count.value == 0), "the flooder")
        attempts = (_stop_once(nodes, running, count, rng) for _ in range(_ATTEMPTS * trials))
        stops = list(islice((stop for stop in attempts if stop is not None), trials))
        if len(stops) < trials:
            raise WbcError(f"machine too slow for {trials} stops under the flood {kind!r}")
    finally:
        count.value = -(2**62)
        flooder.join(5.0)
        flooder.kill()
    status = nodes.stop("controller")
    if status != 0 or not nodes.record.exists():
        raise WbcError(f"the controller ended with exit status {status} after the flood {kind!r}")
    recorded = Recording(nodes.record)
    record, gaps, period = recorded.arrays(), _gaps(recorded), 1.0 / nodes.settings.control.rate
    return [_compared(kind, stop, record, gaps, period) for stop in stops]


def _compared(
    kind: str, stop: Stop, record: Mapping[str, np.ndarray], gaps: Sequence[tuple[int, int, int]], period: float
) -> StopTrial:
    stamps = record["stamp"]
    after = stamps > stop.known
    obeyed = np.flatnonzero(after & ~record["tau"].any(axis=1) & (record["mode"] == "fault"))
    cycles = most = math.ceil(stop.delay / period) + 1  # upper bound from the sender's waiting time
    if len(obeyed):
        missing = sum(count for start, end, count in gaps if end > stop.known and start < stamps[obeyed[0]])
        cycles = int(after[: obeyed[0] + 1].sum()) + min(missing, most)
    slowest = record["seconds/total"][(stamps >= stop.began) & (stamps <= stop.ended)].max(initial=0.0)
    return StopTrial(kind, stop, cycles, float(slowest), period)


def _gaps(recorded: Recording) -> list[tuple[int, int, int]]:
    known = [(each.number, each.stamp) for each in recorded.cycles()]
    return [(start, end, number - last - 1) for (last, start), (number, end) in pairwise(known) if number > last + 1]


def _stop_once(nodes: RobotProcesses, running: Any, count: Any, rng: np.random.Generator) -> Stop | None:
    """Activate, flood and stop; None if the machine's lateness caused another fault."""
    nodes.activate()
    nodes.wait_for_torques(time.monotonic())
    nodes.lateness.worst = 0.0
    count.value = 0
    running.set()
    nodes.until(lambda: count.value > 0, "the first message of the flood")
    began, start = time.monotonic(), nodes.stamp()
    time.sleep(rng.uniform(*_TIME_BEFORE_STOP))
    known = nodes.stamp()
    nodes.user.send_text("command", "estop")
    sent_at = time.monotonic()
    nodes.until(lambda: nodes.state_of("controller").startswith("fault"), "the stop", patience=60.0)
    time.sleep(_TIME_AFTER_STOP)
    running.clear()
    seconds, late, sent = time.monotonic() - began, nodes.lateness.worst, count.value
    if "ESTOP" not in (fault := nodes.state_of("controller")):
        if late < MACHINE * nodes.settings.safety.state_timeout:
            raise WbcError(f"fault {fault!r} before the stop, with a lateness of the machine of {late:.3f} s")
        return None
    times, torques = nodes.efforts(sent_at)
    losses_reported, deadline = False, time.monotonic() + _DIAGNOSTICS_TIMEOUT
    while not losses_reported and time.monotonic() < deadline:
        losses_reported = any(
            entry.key.startswith("refused") for _, content in nodes.messages_since("controller/diagnostics", began)
            for entry in content.status[0].values
        )  # fmt: skip
        time.sleep(0.02)
    delay = float(times[~torques.any(axis=1)][0] - sent_at)
    return Stop(start, known, nodes.stamp(), delay, late, sent, seconds, losses_reported)
