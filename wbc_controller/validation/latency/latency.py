"""From joint state to torques between two processes: the controller as it runs, beside a bare echo of the same bytes.

The controller and the guard are processes as on a robot. This process is the robot: in turn it sends states to the
controller, and to the echo while the controller's process is stopped.
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
from typing import Protocol

from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import MOCK_TOPICS, Endpoint, counterpart, endpoints
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.processes import Processes, memory, processor_time, until, waiting_time
from wbc_controller.nodes.realtime import apply, in_force, processors, step_back
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.settings import RealtimeSettings
from wbc_controller.simulation.mock_robot import NODE_NAME as MOCK_NODE
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.validation.latency import DOMAIN
from wbc_controller.validation.latency.meter import Meter, RoundTrips, joined
from wbc_controller.validation.latency.robots import StandingRobot, echo, opened
from wbc_controller.validation.user import activation_commands, reliable_counterpart

#: Duration of a block, s: shorter than the time after which DDS takes a process that is stopped for gone.
_BLOCK = 3.0
#: Time at the beginning of a block that is not measured, s; of one with a mock robot, after its release.
_SETTLE, _LANDING = 0.5, 2.0
#: Ramp of the activation where no robot has to stand by it, s.
_RAMP = 0.1
#: Namespace of the echo's topics.
_ECHO = "/bench_echo"


@dataclass(frozen=True, slots=True)
class Latency:
    """What was measured."""

    controller: RoundTrips  # the round trips by the controller
    echo: RoundTrips  # those by the echo
    active: float  # share of one processor that the active controller used
    inactive: float  # the same of the inactive controller, before its first activation, while states arrived
    waiting: float  # time for which threads of the controller waited for a processor, as a share of the time
    memory: tuple[int, int]  # of the controller, at the beginning and at the end, kB
    scheduling: str  # how the controller's main thread is scheduled
    said: tuple[str, ...]  # the controller's states other than `active` while it was measured


class _Robot(Protocol):
    def run(self, stop: threading.Event) -> None: ...


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
        rate: states per second, and cycles; by default as configured.
        seconds: duration of each of the two, s.
        transport: ``dds`` or ``rclpy``.
        mock: take the mock robot with its physics in place of one that only sends states; in one block.
        progress: called after each block with the time that was measured so far, s, and the block.

    Raises:
        ConfigurationError: if the robot, the rate or the transport cannot be used, or this is not Linux.
        WbcError: if a process does not do what it should.
    """
    if not sys.platform.startswith("linux"):
        raise ConfigurationError(f"wbc bench latency reads what processes use from /proc: {sys.platform} has none")
    if not (0.0 < seconds < math.inf):
        raise ConfigurationError(f"seconds = {seconds}: must be positive and finite")
    with contextlib.ExitStack() as stack:
        joined_domain = stack.enter_context(opened(transport, "bench_robot", domain))
        changes = {} if rate is None else {"control.rate": rate}
        if not mock:  # it is activated for each block
            changes["safety.activation_ramp"] = _RAMP
        processes = stack.enter_context(contextlib.closing(Processes(robot, folder, domain, changes)))
        bench = _Bench(processes, joined_domain, transport, domain, mock)
        stack.enter_context(bench.echoing())
        return bench.run(seconds, 1 if mock else math.ceil(seconds / _BLOCK), progress)


class _Bench:
    """The processes, and this end of their topics."""

    def __init__(self, processes: Processes, transport: Transport, kind: str, domain: int, mock: bool) -> None:
        settings = processes.settings
        model = make_model(settings)
        self._processes, self._kind, self._domain = processes, kind, domain
        self._period = 1.0 / settings.control.rate
        self._said: list[str] = []
        self._mock = mock
        topics = controller_endpoints(settings, model)
        self._echo_topics = controller_endpoints(settings, model, namespace=_ECHO)
        self._size = model.actuation.command_size
        self._meter, self._echo_meter = Meter(transport), Meter(transport)
        self._listen(self._meter, topics, ("joint_commands",) if mock else ("effort", "joint_commands"))
        self._listen(self._echo_meter, self._echo_topics, ("effort", "joint_commands"))
        by_key = {topic.key: topic for topic in topics}
        self._command = transport.advertise(counterpart(by_key["command"]))
        state = by_key["state"]
        transport.subscribe(
            counterpart(state), lambda payload: self._said.append(str(decode(payload, state.type).data))
        )
        self._robot: _Robot
        if mock:
            self._robot = MockRobot(model, settings, self._meter)
            (hold,) = (topic for topic in endpoints(MOCK_TOPICS, MOCK_NODE) if topic.key == "hold")
            self._hold = transport.advertise(counterpart(hold))
        else:
            self._robot = StandingRobot(model, settings, self._meter, topics)
        self._echo_robot = StandingRobot(model, settings, self._echo_meter, self._echo_topics)
        # The robot's process must not be what is late. As where processors are isolated, it, the guard and what writes
        # recordings have others than the controller, where there are any.
        asked = settings.control.realtime
        others = sorted(processors() - set(asked.affinity)) if asked.affinity else []
        apply(RealtimeSettings(affinity=others))
        self._start("controller")
        self._start("guard")
        apply(RealtimeSettings(scheduling=asked.scheduling, priority=asked.priority, affinity=others))
        self._echo_as = RealtimeSettings(affinity=asked.affinity)  # its class is inherited

    def _start(self, name: str) -> None:
        if self._kind == "dds":
            self._processes.start(name)
            return
        entry = "main" if name == "controller" else "guard_main"
        command = f"from wbc_controller.node import {entry}; {entry}()"
        parameters = ["--ros-args", "--params-file", str(self._processes.configuration)]
        self._processes.launch(name, [sys.executable, "-c", command, *parameters])

    @contextlib.contextmanager
    def echoing(self) -> Iterator[None]:
        """The echo as a process."""
        context = multiprocessing.get_context("spawn")
        stop = context.Event()
        process = context.Process(
            target=echo, args=(self._kind, self._domain, self._echo_topics, self._size, stop, self._echo_as)
        )
        process.start()
        try:
            yield
        finally:
            if process.is_alive():  # whoever wakes one that was killed waits for it for ever
                stop.set()
            process.join()

    def run(self, seconds: float, blocks: int, progress: Callable[[float, RoundTrips, RoundTrips], None]) -> Latency:
        """Measure both in turn, in some blocks."""
        controller = self._processes.processes["controller"]
        ours: list[RoundTrips] = []
        bare: list[RoundTrips] = []
        active = inactive = waiting = 0.0
        first, said = 0, []
        for count in range(1, blocks + 1):
            controller.send_signal(signal.SIGCONT)
            with _running(self._robot):
                if count == 1:
                    inactive = self._inactive_share(seconds / blocks)
                self._activate()
                heard = len(self._said)
                first = first or memory(controller.pid)
                used, waited, began = processor_time(controller.pid), waiting_time(controller.pid), time.monotonic()
                found = self._meter.measure(seconds / blocks, self._period)
                spent = time.monotonic() - began
                self._check_that_it_runs()
                active += (processor_time(controller.pid) - used) / spent
                waiting += (waiting_time(controller.pid) - waited) / spent
                said += self._said[heard:]
                last, scheduling = memory(controller.pid), in_force(controller.pid)
                if not self._mock:
                    self._end_active()
            ours.append(found())
            controller.send_signal(signal.SIGSTOP)
            with _running(self._echo_robot):
                until(lambda: self._echo_meter.answered, "the echo")
                time.sleep(_SETTLE)
                found = self._echo_meter.measure(seconds / blocks, self._period)
            bare.append(found())
            progress(count * seconds / blocks, ours[-1], bare[-1])
        return Latency(
            controller=joined(ours),
            echo=joined(bare),
            active=active / blocks,
            inactive=inactive,
            waiting=waiting / blocks,
            memory=(first, last),
            scheduling=scheduling,
            said=tuple(said),
        )

    def _inactive_share(self, seconds: float) -> float:
        """Return the share of one processor that the controller uses before its first activation, over a block."""
        self._until(lambda: self._mode() == "inactive", "the controller to be inactive", lambda: None)
        time.sleep(_SETTLE)
        controller = self._processes.processes["controller"].pid
        used, began = processor_time(controller), time.monotonic()
        time.sleep(min(seconds, _BLOCK))
        return (processor_time(controller) - used) / (time.monotonic() - began)

    def _listen(self, meter: Meter, topics: list[Endpoint], keys: tuple[str, ...]) -> None:
        """Open the topics that the meter notes."""
        for topic in topics:
            if topic.key in keys:
                meter.subscribe(reliable_counterpart(topic), lambda payload: None)

    def _send(self, word: str) -> None:
        self._command(encode(message("std_msgs/msg/String", data=word)))

    def _mode(self) -> str:
        return self._said[-1] if self._said else ""

    def _activate(self) -> None:
        """Activate the controller, from any mode; with a mock robot, let it stand on its own feet."""

        def ask() -> None:
            for word in activation_commands(self._mode()):
                self._send(word)

        self._until(lambda: self._mode() == "active", "the activation", ask)
        time.sleep(_SETTLE)
        if self._mock:
            time.sleep(self._processes.settings.safety.activation_ramp)
            self._hold(encode(message("std_msgs/msg/Bool", data=False)))
            time.sleep(_LANDING)

    def _end_active(self) -> None:
        """Leave the active mode, from whatever came of it."""

        def ask() -> None:
            self._send("deactivate" if self._mode() in ("active", "holding") else "reset")

        self._until(lambda: self._mode() == "inactive", "the controller to be inactive", ask)

    def _until(self, condition: Callable[[], bool], what: str, again: Callable[[], None]) -> None:
        def alive() -> None:
            self._check_that_it_runs()
            again()

        until(condition, what, alive, told=lambda: f"; it said {self._mode()!r}\n{self._processes.log('controller')}")

    def _check_that_it_runs(self) -> None:
        status = self._processes.processes["controller"].poll()
        if status is not None:
            raise WbcError(f"the controller ended with exit status {status}:\n{self._processes.log('controller')}")


@contextlib.contextmanager
def _running(robot: _Robot) -> Iterator[None]:
    """Let a robot run on a thread, behind those that note when torques come; what it raises is raised at the end."""
    stop = threading.Event()
    with concurrent.futures.ThreadPoolExecutor(1, "robot", step_back) as pool:
        running = pool.submit(robot.run, stop)
        try:
            yield
        finally:
            stop.set()
        running.result()
