"""Real processes on a DDS domain of their own, and a user who talks to them: what the live trials share."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.robot import make_model
from wbc_controller.middleware.codec import decode, encode, message, nanoseconds
from wbc_controller.middleware.joint_states import JointStateReader
from wbc_controller.middleware.states import OdometryReader
from wbc_controller.middleware.topics import GUARD_TOPICS, MOCK_TOPICS, Direction, Endpoint, counterpart, endpoints
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.nodes.guard_service import NODE_NAME as GUARD_NODE
from wbc_controller.nodes.processes import PATIENCE, Processes, until
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.records import Array
from wbc_controller.simulation.mock_robot import NODE_NAME as MOCK_NODE
from wbc_controller.validation.fuzz import DOMAIN

#: Messages that are kept of each topic: a minute of the fastest ones.
_KEPT = 30_000
#: What a user listens to, by node.
_HEARD = {
    "controller": ("effort", "joint_commands", "state", "diagnostics"),
    "mock": ("joint_states", "odom"),
    "guard": ("state",),
}
#: Lateness of the machine from which a fault of time is the machine's, as a share of the time that the fault allows.
MACHINE = 0.5


class Lateness:
    """How late this machine is: how late bare threads wake up, and how long watched processes wait for a processor.

    Attributes:
        worst: largest lateness since `forget`, s: of a nap on any processor, or of any thread of this process or of a
            watched one within `_WINDOW`.
    """

    _NAP, _LOOK, _WINDOW = 0.001, 0.01, 0.05

    def __init__(self) -> None:
        self.worst = 0.0
        self._lock = threading.Lock()
        self._processes = {os.getpid()}
        self._waited: dict[Path, deque[tuple[float, float]]] = {}
        self._ended = False
        # A nap on each processor: on a virtual machine one of them may stand still alone.
        naps = [threading.Thread(target=self._nap, args=(cpu,), daemon=True) for cpu in os.sched_getaffinity(0)]
        self._threads = [*naps, threading.Thread(target=self._look, name="lateness", daemon=True)]
        for thread in self._threads:
            thread.start()

    def watch(self, process: int) -> None:
        """Watch the threads of a process, too."""
        self._processes.add(process)

    def forget(self) -> None:
        """Begin anew."""
        self.worst = 0.0

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
            self._note(time.monotonic() - began - self._NAP)

    def _look(self) -> None:
        while not self._ended:
            time.sleep(self._LOOK)
            now = time.monotonic()
            for process in list(self._processes):
                try:
                    tasks = list(Path(f"/proc/{process}/task").glob("*/schedstat"))
                except FileNotFoundError:  # it ended while it was looked at
                    tasks = []
                if not tasks:
                    self._processes.discard(process)
                for task in tasks:
                    self._look_at(task, now)

    def _look_at(self, task: Path, now: float) -> None:
        try:  # time on the processor, time of waiting for one, ns
            total = 1.0e-9 * int(task.read_text().split()[1])
        except (OSError, IndexError):  # it has ended
            self._waited.pop(task, None)
            return
        waited = self._waited.setdefault(task, deque())
        waited.append((now, total))
        while now - waited[0][0] > self._WINDOW and len(waited) > 2:
            waited.popleft()
        self._note(total - waited[0][1])

    def _note(self, late: float) -> None:
        with self._lock:
            self.worst = max(self.worst, late)


class Rig(Processes):
    """A mock robot, a controller and a guard as processes, and a user on the same domain.

    Attributes:
        model: of the robot.
        record: a file for the controller's record.
        lateness: of this machine.
    """

    def __init__(
        self, robot: str, folder: Path, domain: int = DOMAIN, changes: Mapping[str, Any] | None = None
    ) -> None:
        """Join the domain. No process is started yet.

        Args:
            robot: a robot that is shipped, or the path of a configuration.
            folder: for the configuration, the logs and the record; it is made.
            domain: DDS domain.
            changes: of settings, by dotted key.
        """
        super().__init__(robot, folder, domain, changes)
        self.model = make_model(self.settings)
        self.record = folder / "cycles.mcap"
        self.lateness = Lateness()
        self.kept: dict[str, deque[tuple[float, bytes]]] = {}
        self._types: dict[str, str] = {}
        self.inputs: dict[str, Endpoint] = {}
        self._transport = DdsTransport("trial_user", domain_id=domain, discovery_range="LOCALHOST")
        owners: dict[str, list[Endpoint]] = {
            "controller": controller_endpoints(self.settings, self.model),
            "mock": list(endpoints(MOCK_TOPICS, MOCK_NODE, contacts=self.settings.contacts)),
            "guard": list(endpoints(GUARD_TOPICS, GUARD_NODE)),
        }
        for owner, topics in owners.items():
            for topic in topics:
                if topic.direction is Direction.OUT and topic.key in _HEARD[owner]:
                    self._listen(f"{owner}/{topic.key}", topic)
                if topic.direction is Direction.IN and owner == "controller":
                    self.inputs[f"{topic.key}/{topic.subject}".rstrip("/")] = topic
        self.advertise = self._transport.advertise
        self._command = self.advertise(counterpart(self.inputs["command"]))

    def __enter__(self) -> Rig:
        return self

    def close(self) -> None:
        """End all processes, and leave the domain."""
        super().close()
        self._transport.close()
        self.lateness.end()

    def _listen(self, name: str, topic: Endpoint) -> None:
        kept = self.kept[name] = deque(maxlen=_KEPT)
        self._types[name] = topic.type
        deep = dataclasses.replace(counterpart(topic), qos=dataclasses.replace(topic.qos, depth=1000))
        self._transport.subscribe(deep, lambda payload: kept.append((time.monotonic(), payload)))

    def launch(self, name: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a process by its command line, and watch how late it is."""
        process = super().launch(name, command)
        self.lateness.watch(process.pid)
        return process

    def command(self, word: str) -> float:
        """Send a word to the controller; when, on the monotonic clock, s."""
        self._command(encode(message("std_msgs/msg/String", data=word)))
        return time.monotonic()

    def said(self, node: str) -> str:
        """The newest state of ``controller`` or ``guard``; empty where it has said none."""
        kept = self.kept[f"{node}/state"]
        return str(decode(kept[-1][1], self._types[f"{node}/state"]).data) if kept else ""

    def stamp(self) -> int:
        """Stamp of the robot's newest state, ns; 0 before the first one."""
        kept = self.kept["mock/joint_states"]
        return nanoseconds(decode(kept[-1][1], self._types["mock/joint_states"]).header.stamp) if kept else 0

    def centre_of_mass(self) -> Array:
        """The robot's centre of mass in its newest state, (3,) in m."""
        joints, base = (self.kept[f"mock/{key}"][-1][1] for key in ("joint_states", "odom"))
        q = np.zeros(self.model.nq)
        q[self.model.q_index] = JointStateReader(self.model.joints).read(joints).position
        q[:7] = OdometryReader(self.model.base_link).read(base).pose
        return np.array(pin.centerOfMass(self.model.pinocchio, self.model.pinocchio.createData(), q))

    def heard(self, name: str, since: float = 0.0) -> list[tuple[float, Any]]:
        """Messages of a topic such as ``controller/effort`` that came after a time, with their times, oldest first."""
        recent = [each for each in list(self.kept[name]) if each[0] > since]
        return [(when, decode(payload, self._types[name])) for when, payload in recent]

    def efforts(self, since: float) -> tuple[Array, Array]:
        """Times, (n,) in s, and torques, (n, na) in N·m, of what came for the joints after a time."""
        heard = self.heard("controller/effort", since)
        torques = np.array([content.data for _, content in heard]).reshape(-1, self.model.na)
        return np.array([when for when, _ in heard]), torques

    def until(
        self,
        condition: Callable[[], Any],
        what: str,
        again: Callable[[], Any] = lambda: None,
        patience: float = PATIENCE,
    ) -> None:
        """Wait for a condition, doing `again` four times a second.

        Raises:
            WbcError: if it does not come true in time.
        """
        until(
            condition,
            what,
            again,
            patience,
            lambda: f"; controller: {self.said('controller')!r}, guard: {self.said('guard')!r}",
        )

    def wait_for(self, *names: str) -> None:
        """Wait for the first messages of processes that have just been started."""
        topics = {"mock": "mock/joint_states", "controller": "controller/state", "guard": "guard/state"}
        for name in names:
            kept = self.kept[topics[name]]
            self.until(kept.__len__, f"the first message of {name}")

    def forget(self, *names: str) -> None:
        """Forget what a node has said."""
        for name, kept in self.kept.items():
            if name.partition("/")[0] in names:
                kept.clear()

    def activate(self) -> None:
        """Reset a fault, and activate the controller."""

        def ask() -> None:
            if not self.said("controller").startswith("inactive"):
                self.command("reset")
            self.command("activate")

        self.until(lambda: self.said("controller") == "active", "the activation", ask)
