"""Latency from joint state to torques.

This process is the robot, and sends states to the controller and the echo in turn.
"""

import concurrent.futures
import contextlib
import math
import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import MOCK_NODE, MOCK_TOPICS, Endpoint, counterpart, endpoints
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.processes import Processes, memory, processor_time, waiting_times
from wbc_controller.nodes.realtime import apply_realtime, describe_scheduling, lower_thread_priority, processors
from wbc_controller.nodes.user import reliable_counterpart
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.settings.service import RealtimeSettings
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.validation.latency import DOMAIN
from wbc_controller.validation.latency.meter import QUANTILES, Meter, RoundTrips, joined
from wbc_controller.validation.latency.robots import StandingRobot, echo, open_transport

_BLOCK = 3.0  # s; shorter than DDS's lease of a stopped process
_SETTLE, _LANDING = 0.5, 2.0  # unmeasured, s; second value after the release of a mock robot
_RAMP = 0.1  # without a mock robot, s
_ECHO = "/bench_echo"


@dataclass(frozen=True, slots=True)
class Latency:
    """Results of a measurement."""

    controller: RoundTrips  # round trips of the controller
    echo: RoundTrips  # round trips of the echo
    active: float  # share of one processor, active
    inactive: float  # share before the first activation, with states
    waiting: float  # share of the time that threads waited for a processor
    memory: tuple[int, int]  # at the start and at the end, kB
    scheduling: str  # of the main thread
    inactive_states: tuple[str, ...]  # during the measurement


def measure_latency(
    robot: str,
    folder: Path,
    *,
    rate: float | None = None,
    seconds: float = 60.0,
    transport: str = "dds",
    mock: bool = False,
    domain: int = DOMAIN,
    progress: Callable[[float, RoundTrips, RoundTrips], None] = lambda done, controller, echo: None,
) -> Latency:
    """Measure the controller and the echo in turn, in blocks.

    Args:
        rate: states per second; by default as configured.
        seconds: for each, s.
        transport: ``dds`` or ``rclpy``.
        mock: use the mock robot, in one block.
        progress: receives the measured time, s, and the round trips of each block.

    Raises:
        ConfigurationError: if an argument is invalid, or the system is not Linux.
    """
    if not sys.platform.startswith("linux"):
        raise ConfigurationError(f"wbc bench latency requires /proc (Linux), got {sys.platform}")
    if not (0.0 < seconds < math.inf):
        raise ConfigurationError(f"seconds = {seconds}; valid: positive and finite")
    with contextlib.ExitStack() as stack:
        joined_domain = stack.enter_context(open_transport(transport, "bench_robot", domain))
        changes = {} if rate is None else {"control.rate": rate}
        if not mock:  # activated for each block
            changes["safety.activation_ramp"] = _RAMP
        processes = stack.enter_context(contextlib.closing(Processes(robot, folder, domain, changes)))
        bench = _Bench(processes, joined_domain, transport, domain, mock)
        stack.enter_context(bench.run_echo())
        return bench.run(seconds, 1 if mock else math.ceil(seconds / _BLOCK), progress)


class _Bench:
    def __init__(self, processes: Processes, transport: Transport, kind: str, domain: int, mock: bool) -> None:
        settings = processes.settings
        model = make_model(settings)
        self._processes, self._kind, self._domain = processes, kind, domain
        self._period = 1.0 / settings.control.rate
        self._states: list[str] = []
        processes.details = lambda: f"; it said {self._mode()!r}\n{processes.log('controller')}"
        self._mock = mock
        topics = controller_endpoints(settings, model)
        self._echo_topics = controller_endpoints(settings, model, namespace=_ECHO)
        self._size = model.actuation.command_size
        self._meter, self._echo_meter = Meter(transport), Meter(transport)
        self._subscribe(self._meter, topics, ("joint_commands",) if mock else ("effort", "joint_commands"))
        self._subscribe(self._echo_meter, self._echo_topics, ("effort", "joint_commands"))
        by_key = {topic.key: topic for topic in topics}
        self._command = transport.advertise(counterpart(by_key["command"]))
        state = by_key["state"]
        transport.subscribe(
            counterpart(state), lambda payload: self._states.append(str(decode(payload, state.type).data))
        )
        self._robot: MockRobot | StandingRobot
        if mock:
            self._robot = MockRobot(model, settings, self._meter)
            (hold,) = (topic for topic in endpoints(MOCK_TOPICS, MOCK_NODE) if topic.key == "hold")
            self._hold = transport.advertise(counterpart(hold))
        else:
            self._robot = StandingRobot(model, settings, self._meter, topics)
        self._echo_robot = StandingRobot(model, settings, self._echo_meter, self._echo_topics)
        # This process must not cause lateness: it uses other processors than the controller, if possible.
        realtime = settings.control.realtime
        others = sorted(processors() - set(realtime.affinity)) if realtime.affinity else []
        apply_realtime(RealtimeSettings(affinity=others))
        self._start("controller")
        self._start("guard")
        apply_realtime(RealtimeSettings(scheduling=realtime.scheduling, priority=realtime.priority, affinity=others))
        self._echo_realtime = RealtimeSettings(affinity=realtime.affinity)

    def _start(self, name: str) -> None:
        if self._kind == "dds":
            self._processes.start(name)
            return
        entry = "main" if name == "controller" else "guard_main"
        command = f"from wbc_controller.node import {entry}; {entry}()"
        parameters = ["--ros-args", "--params-file", str(self._processes.configuration)]
        self._processes.launch(name, [sys.executable, "-c", command, *parameters])

    @contextlib.contextmanager
    def run_echo(self) -> Iterator[None]:
        context = multiprocessing.get_context("spawn")
        stop = context.Event()
        process = context.Process(
            target=echo, args=(self._kind, self._domain, self._echo_topics, self._size, stop, self._echo_realtime)
        )
        process.start()
        try:
            yield
        finally:
            if process.is_alive():  # setting the event of a killed process would block
                stop.set()
            process.join()

    def run(self, seconds: float, blocks: int, progress: Callable[[float, RoundTrips, RoundTrips], None]) -> Latency:
        controller = self._processes.processes["controller"]
        ours: list[RoundTrips] = []
        bare: list[RoundTrips] = []
        active = inactive = waiting = 0.0
        first, inactive_states = 0, []
        for count in range(1, blocks + 1):
            controller.send_signal(signal.SIGCONT)
            with _running(self._robot):
                if count == 1:
                    inactive = self._inactive_share(seconds / blocks)
                self._activate()
                known = len(self._states)
                first = first or memory(controller.pid)
                waited = sum(waiting_times(controller.pid).values())
                used, began = processor_time(controller.pid), time.monotonic()
                found = self._meter.measure(seconds / blocks, self._period)
                spent = time.monotonic() - began
                self._processes.check()
                active += (processor_time(controller.pid) - used) / spent
                waiting += (sum(waiting_times(controller.pid).values()) - waited) / spent
                inactive_states += self._states[known:]
                last, scheduling = memory(controller.pid), describe_scheduling(controller.pid)
                if not self._mock:
                    self._end_active()
            ours.append(found())
            controller.send_signal(signal.SIGSTOP)
            with _running(self._echo_robot):
                self._processes.until(lambda: self._echo_meter.answered, "the echo")
                time.sleep(_SETTLE)
                found = self._echo_meter.measure(seconds / blocks, self._period)
            bare.append(found())
            progress(count * seconds / blocks, ours[-1], bare[-1])
        shares = active / blocks, inactive, waiting / blocks
        return Latency(joined(ours), joined(bare), *shares, (first, last), scheduling, tuple(inactive_states))

    def _inactive_share(self, seconds: float) -> float:
        self._processes.until(lambda: self._mode() == "inactive", "the inactive mode")
        time.sleep(_SETTLE)
        controller = self._processes.processes["controller"].pid
        used, began = processor_time(controller), time.monotonic()
        time.sleep(min(seconds, _BLOCK))
        return (processor_time(controller) - used) / (time.monotonic() - began)

    def _subscribe(self, meter: Meter, topics: list[Endpoint], keys: tuple[str, ...]) -> None:
        for topic in topics:
            if topic.key in keys:
                meter.subscribe(reliable_counterpart(topic), lambda payload: None)

    def _send(self, word: str) -> None:
        self._command(encode(message("std_msgs/msg/String", data=word)))

    def _mode(self) -> str:
        return self._states[-1] if self._states else ""

    def _activate(self) -> None:
        self._processes.until_active(self._mode, self._send)
        time.sleep(_SETTLE)
        if self._mock:
            time.sleep(self._processes.settings.safety.activation_ramp)
            self._hold(encode(message("std_msgs/msg/Bool", data=False)))
            time.sleep(_LANDING)

    def _end_active(self) -> None:
        def ask() -> None:
            self._send("deactivate" if self._mode() in ("active", "holding") else "reset")

        self._processes.until(lambda: self._mode() == "inactive", "the inactive mode", ask)


@contextlib.contextmanager
def _running(robot: MockRobot | StandingRobot) -> Iterator[None]:
    stop = threading.Event()
    with concurrent.futures.ThreadPoolExecutor(1, "robot", lower_thread_priority) as pool:
        running = pool.submit(robot.run, stop)
        try:
            yield
        finally:
            stop.set()
        running.result()


def figures(found: Latency) -> dict[str, Any]:
    """Return the results by name and unit, for a file."""
    ours, bare = found.controller, found.echo
    return {
        "rate_hz": 1.0 / ours.period,
        "controller_us": _microseconds(ours.quantiles),
        "echo_us": _microseconds(bare.quantiles),
        "difference_us": _microseconds(_difference(found)),
        "controller": _counts(ours),
        "echo": _counts(bare),
        "controller_processor_share": {"active": found.active, "inactive": found.inactive},
        "controller_waiting_share": found.waiting,
        "controller_memory_kb": list(found.memory),
        "states_delayed_us": _microseconds(ours.delay_quantiles),
        "scheduling": found.scheduling,
        "inactive_states": list(found.inactive_states),
    }


def lines(found: Latency) -> list[str]:
    """Return the results as lines of text."""
    ours, bare = found.controller, found.echo
    rows = {"controller": ours.quantiles, "bare echo": bare.quantiles, "difference": _difference(found)}
    table = [f"{'us':12}" + "".join(f"{name:>9}" for name in QUANTILES)]
    table += [f"{name:12}" + "".join(f"{1e6 * value:9.0f}" for value in row) for name, row in rows.items()]
    first, last = (kilobytes / 1024.0 for kilobytes in found.memory)
    delays = [f"{name} {1e6 * value:.0f} us" for name, value in zip(QUANTILES, ours.delay_quantiles, strict=True)]
    inactive_states = ", ".join(dict.fromkeys(found.inactive_states))
    return [
        *table,
        f"late: {_late(ours)} at {1.0 / ours.period:g} Hz, echo {_late(bare)}",
        f"controller: {100.0 * found.active:.1f} % of one processor active, {100.0 * found.inactive:.1f} % inactive; "
        f"{first:.1f} MB at the start, {last:.1f} MB at the end; {found.scheduling}",
        f"machine: delay of states beyond the period {', '.join(delays)}; the controller's threads "
        f"waited for a processor for {100.0 * found.waiting:.2f} % of the time",
        *([f"inactive states of the controller: {inactive_states}"] if inactive_states else []),
    ]


def _difference(found: Latency) -> tuple[float, ...]:
    return tuple(a - b for a, b in zip(found.controller.quantiles, found.echo.quantiles, strict=True))


def _late(trips: RoundTrips) -> str:
    count = trips.seconds.size
    return f"{100.0 * trips.late / count:.3f} % of {count} states ({trips.unanswered} without torques)"


def _counts(trips: RoundTrips) -> dict[str, int]:
    return {"states": trips.seconds.size, "late": trips.late, "without_torques": trips.unanswered}


def _microseconds(values: tuple[float, ...]) -> dict[str, float]:
    return {name: 1e6 * value for name, value in zip(QUANTILES, values, strict=True)}
