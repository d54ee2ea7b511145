"""Mock robot, controller and guard as processes, and the lateness of the machine."""

import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.extras import require_libraries
from wbc_controller.middleware.codec import decode, nanoseconds
from wbc_controller.middleware.topics import Direction
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.nodes.processes import Processes, waiting_times
from wbc_controller.nodes.user import User, reliable_counterpart
from wbc_controller.nodes.wiring import controller_endpoints, topics_of
from wbc_controller.records import Array

MACHINE = 0.5  # smallest lateness that counts as a fault's cause, as a share of its time limit
_CAPACITY = 30_000  # messages per topic
#: Stored topics by node and key.
_HEARD = (
    "controller/effort", "controller/joint_commands", "controller/state", "controller/diagnostics", "mock/joint_states",
    "guard/state",
)  # fmt: skip


def _store(messages: deque[tuple[float, bytes]], payload: bytes) -> None:
    messages.append((time.monotonic(), payload))


class RobotProcesses(Processes):
    """Mock robot, controller and guard as processes, and a user in the same domain."""

    def __init__(self, robot: str, folder: Path, domain: int, changes: Mapping[str, Any] | None = None) -> None:
        require_libraries("mujoco")  # of the mock robot
        super().__init__(robot, folder, domain, changes)
        self.details = lambda: f"; controller: {self.state_of('controller')!r}, guard: {self.state_of('guard')!r}"
        self.model = make_model(self.settings)
        self.record = folder / "cycles.mcap"
        self.lateness = Lateness()
        #: Arrival times and payloads by node and key, such as ``guard/state``.
        self.messages: dict[str, deque[tuple[float, bytes]]] = {}
        self._types: dict[str, str] = {}
        self._transport = DdsTransport("trial_user", domain_id=domain, discovery_range="LOCALHOST")
        for (node, key, _), topic in topics_of(self.settings).items():
            if topic.direction is Direction.OUT and (name := f"{node}/{key}") in _HEARD:
                messages = self.messages[name] = deque(maxlen=_CAPACITY)
                self._types[name] = topic.type
                self._transport.subscribe(reliable_counterpart(topic), partial(_store, messages))
        topics = controller_endpoints(self.settings, self.model)
        #: Topics of the controller, by key and subject, such as ``setpoint/com``.
        self.inputs = {
            f"{topic.key}/{topic.subject}".rstrip("/"): topic for topic in topics if topic.direction is Direction.IN
        }
        self.user = User(self.settings, self.model, topics, self._transport)

    def __enter__(self) -> "RobotProcesses":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End all processes, and leave the domain."""
        super().close()
        self._transport.close()
        self.lateness.end()

    def launch(self, name: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a process by its command line, and measure its lateness."""
        process = super().launch(name, command)
        self.lateness.processes.add(process.pid)
        return process

    def start_and_wait(self, *names: str) -> None:
        """Start ``mock``, ``controller`` or ``guard``, and wait for the first message of each."""
        for name in names:
            self.start(name)
        self.wait_for(*names)

    def wait_for(self, *names: str) -> None:
        """Wait for the first message of some nodes."""
        topics = {"mock": "mock/joint_states", "controller": "controller/state", "guard": "guard/state"}
        for name in names:
            self.until(self.messages[topics[name]].__len__, f"the first message of {name}")

    def newest(self, name: str) -> Any:
        """Return the newest message of a topic such as ``guard/state``, or None."""
        messages = self.messages[name]
        return decode(messages[-1][1], self._types[name]) if messages else None

    def state_of(self, node: str) -> str:
        """Return the newest state of ``controller`` or ``guard``."""
        newest = self.newest(f"{node}/state")
        return "" if newest is None else str(newest.data)

    def stamp(self) -> int:
        """Return the stamp of the newest state, ns; initially 0."""
        newest = self.newest("mock/joint_states")
        return 0 if newest is None else nanoseconds(newest.header.stamp)

    def messages_since(self, name: str, since: float) -> list[tuple[float, Any]]:
        """Return the messages of a topic after a time, with arrival times."""
        recent = [each for each in list(self.messages[name]) if each[0] > since]
        return [(when, decode(payload, self._types[name])) for when, payload in recent]

    def efforts(self, since: float) -> tuple[Array, Array]:
        """Return arrival times, (n,) in s, and torques, (n, na) in N·m, of the commands after a time."""
        received = self.messages_since("controller/effort", since)
        torques = np.array([content.data for _, content in received]).reshape(-1, self.model.na)
        return np.array([when for when, _ in received]), torques

    def wait_for_torques(self, since: float) -> None:
        """Wait for nonzero torques after a time."""
        self.until(lambda: bool(self.efforts(since)[1].any()), "torques")

    def clear(self, *names: str) -> None:
        """Delete the messages of some nodes."""
        for name, messages in self.messages.items():
            if name.partition("/")[0] in names:
                messages.clear()

    def activate(self) -> None:
        """Reset a fault, and activate the controller."""
        self.until_active(partial(self.state_of, "controller"), partial(self.user.send_text, "command"))


class Lateness:
    """Lateness of sleeps and of the threads of processes; `worst` is the largest since its last reset to 0, s."""

    _NAP, _LOOK, _WINDOW = 0.001, 0.01, 0.05

    def __init__(self) -> None:
        self.worst = 0.0
        self._lock = threading.Lock()
        self.processes = {os.getpid()}
        self._waited: dict[Path, deque[tuple[float, float]]] = {}
        self._ended = False
        naps = [threading.Thread(target=self._nap, args=(cpu,), daemon=True) for cpu in os.sched_getaffinity(0)]
        self._threads = [*naps, threading.Thread(target=self._check_processes, name="lateness", daemon=True)]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """End the threads."""
        self._ended = True
        for thread in self._threads:
            thread.join()

    def _nap(self, cpu: int) -> None:
        os.sched_setaffinity(0, {cpu})  # of this thread
        while not self._ended:
            began = time.monotonic()
            time.sleep(self._NAP)
            self._record(time.monotonic() - began - self._NAP)

    def _check_processes(self) -> None:
        while not self._ended:
            time.sleep(self._LOOK)
            now, before, self._waited = time.monotonic(), self._waited, {}
            for process in list(self.processes):
                times = waiting_times(process)
                if not times:
                    self.processes.discard(process)
                for thread, total in times.items():
                    waited = self._waited[thread] = before.get(thread, deque())
                    waited.append((now, total))
                    while now - waited[0][0] > self._WINDOW and len(waited) > 2:
                        waited.popleft()
                    self._record(total - waited[0][1])

    def _record(self, late: float) -> None:
        with self._lock:
            self.worst = max(self.worst, late)
