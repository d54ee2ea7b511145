"""Service and mock robot on each transport, and a user of their topics."""

import contextlib
import dataclasses
import os
import re
import signal
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from busy import slowness
from domains import own_domain
from forked import SHORT_LEASE, Forked, fork_node, fork_wbc
from launching import patient
from participants import Ros2Participants, is_omitted
from waiting import until

from wbc_controller.controller.build.robot import make_model
from wbc_controller.middleware.codec import decode, encode, message, nanoseconds
from wbc_controller.middleware.stamps import header_time
from wbc_controller.middleware.states import JointStateReader, OdometryReader
from wbc_controller.middleware.topics import Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.nodes.user import reliable_counterpart
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.settings.files import find_configuration, load_settings

ROBOT = "go2"
DOMAIN = own_domain()
#: Topics with one publisher; advertised only when a test sends on them.
OF_THE_ROBOT = ("joint_states", "odom", "clock", "robot_description", "effort", "joint_commands")


class User:
    """Opens the peer of every topic of both nodes and of the guard's state; stores messages with arrival times."""

    def __init__(
        self, transport: Any, advance: Callable[[], None], omits: Callable[[Endpoint], bool] = lambda topic: False
    ) -> None:
        self.settings = load_settings(find_configuration(ROBOT))
        self.model = make_model(self.settings)
        self.advance = advance
        self.transport = transport
        self.arrivals: dict[tuple[str, str, str], list[tuple[float, bytes]]] = {}
        self._types: dict[tuple[str, str, str], str] = {}
        self._publish: dict[tuple[str, str, str], Callable[[bytes], None]] = {}
        self._writable: dict[tuple[str, str, str], Endpoint] = {}
        self._joints, self._base = JointStateReader(self.model.joints), OdometryReader(self.model.base_link)
        self._data = self.model.pinocchio.createData()
        self.state_came = threading.Event()
        for place, topic in topics_of(self.settings).items():
            if (place[0] in ("controller", "mock") or place == ("guard", "state", "")) and not omits(topic):
                self._open(place, topic)

    def _open(self, key: tuple[str, str, str], topic: Endpoint) -> None:
        self._types[key] = topic.type
        if topic.direction is Direction.IN:
            qos = dataclasses.replace(topic.qos, reliable=True)
            self._writable[key] = dataclasses.replace(counterpart(topic), qos=qos)
            if topic.key not in OF_THE_ROBOT:
                self._publish[key] = self.transport.advertise(self._writable[key])
            return
        kept = self.arrivals[key] = []
        state = key == ("mock", "joint_states", "")

        def receive(payload: bytes) -> None:
            kept.append((time.monotonic(), payload))
            if state:
                self.state_came.set()

        self.transport.subscribe(reliable_counterpart(topic), receive)

    def send(self, owner: str, key: str, content: Any, subject: str = "") -> None:
        place = owner, key, subject
        if place not in self._publish:
            self._publish[place] = self.transport.advertise(self._writable[place])
        self._publish[place](encode(content))

    def command(self, word: str) -> None:
        self.send("controller", "command", message("std_msgs/msg/String", data=word))

    def timed(self, owner: str, key: str, subject: str = "", *, since: float = 0.0) -> list[tuple[float, Any]]:
        """Return wall time and content of each message after a wall time."""
        place = owner, key, subject
        kept = [each for each in list(self.arrivals[place]) if each[0] > since]
        return [(when, decode(payload, self._types[place])) for when, payload in kept]

    def all(self, owner: str, key: str, subject: str = "") -> list[Any]:
        return [content for _, content in self.timed(owner, key, subject)]

    def last(self, owner: str, key: str, subject: str = "") -> Any:
        place = owner, key, subject
        return decode(self.arrivals[place][-1][1], self._types[place])

    @property
    def mode(self) -> str:
        return str(self.last("controller", "state").data) if self.arrivals["controller", "state", ""] else ""

    @property
    def time(self) -> float:
        """Simulated time, s."""
        kept = self.arrivals["mock", "joint_states", ""]
        return header_time(kept[-1][1]) if kept else 0.0

    def run(self, duration: float) -> None:
        """Advance the simulated time."""
        end = self.time + duration
        self.until(lambda: self.time >= end, f"{duration} s of simulated time")

    def until(
        self, condition: Callable[[], Any], what: str, again: Callable[[], None] = lambda: None, patience: float = 60.0
    ) -> None:
        """Wait for a condition; repeat `again`, as new peers may miss a message; `patience` as in `waiting.until`."""
        until(condition, lambda: f"{what}; {self.mode}", patience, again, self.advance)

    def wait_for_service(self) -> None:
        self.until(lambda: self.time > 0.0 and self.mode != "", "the first state and the first mode")

    def activate(self) -> None:
        self.until(lambda: self.mode == "active", "activation", lambda: self.command("activate"))

    def activate_again(self) -> None:
        """Activate from any mode until torques carry the robot, also after faults of a busy machine."""

        def again() -> None:
            if self.mode.partition(" ")[0] not in ("active", "holding", "inactive"):
                self.command("reset")
            self.command("activate")

        self.until(lambda: self.mode == "active" and self.carries(), "torques of an active controller", again)

    def carries(self) -> bool:
        """Return True if the newest torques are non-zero."""
        return bool(self.arrivals["controller", "effort", ""]) and bool(np.any(self.last("controller", "effort").data))

    def com(self) -> np.ndarray:
        q = np.zeros(self.model.nq)
        q[self.model.q_index] = self._joints.read(self.arrivals["mock", "joint_states", ""][-1][1]).position
        q[:7] = self._base.read(self.arrivals["mock", "odom", ""][-1][1]).pose
        return np.array(pin.centerOfMass(self.model.pinocchio, self._data, q))

    def vertical_force(self, owner: str, duration: float) -> np.ndarray:
        """Return the summed contact forces by stamp over `duration`, N."""
        since, contacts = self.time - duration, self.settings.contacts
        forces: dict[float, list[float]] = defaultdict(list)
        for contact in contacts:
            for content in self.all(owner, "contact_wrench", contact):
                forces[nanoseconds(content.header.stamp) * 1e-9].append(content.wrench.force.z)
        return np.array([sum(each) for at, each in forces.items() if at >= since and len(each) == len(contacts)])

    def efforts(self, since: float = 0.0) -> np.ndarray:
        """Return the torques after a wall time."""
        kept = self.timed("controller", "effort", since=since)
        return np.array([content.data for _, content in kept]).reshape(-1, self.model.na)

    def refusals(self) -> list[str]:
        """Return all refusals on /diagnostics."""
        values = [value for content in self.all("controller", "diagnostics") for value in content.status[0].values]
        return [value.value for value in values if re.fullmatch(r"refused/\d+", value.key)]


class Processes:
    """Real processes of the command line on their own domain."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        own = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._environment = {**os.environ, **SHORT_LEASE, **own}
        self._started: list[Forked] = []

    def start(self, *words: str) -> Forked:
        self._started.append(fork_wbc(self._environment, self._log(words[0]), *words))
        return self._started[-1]

    def start_node(self, main: str, *parameters: str) -> None:
        self._started.append(fork_node(self._environment, self._log(main), main, *parameters))

    def _log(self, name: str) -> Path:
        return self._folder / f"{len(self._started):02}-{name}.log"

    def stop(self, process: Forked) -> int:
        process.send_signal(signal.SIGINT)
        try:
            return process.wait(timeout=15 * slowness())
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait(timeout=5)

    def stop_all(self) -> None:
        for process in self._started:
            process.send_signal(signal.SIGINT)
        for process in self._started:
            self.stop(process)

    def logs(self) -> str:
        return "\n".join(f"--- {path.name}\n{path.read_text()}" for path in sorted(self._folder.glob("*.log")))


@pytest.fixture
def patient_robot(tmp_path: Path) -> str:
    """Return a configuration of `ROBOT` that tolerates a busy machine."""
    return str(patient(ROBOT, tmp_path))


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    running = Processes(tmp_path)
    yield running
    running.stop_all()
    print(running.logs())  # shown after a failure


@pytest.fixture
def dds_user() -> Iterator[User]:
    """A user on the domain of the `processes`."""
    from wbc_controller.middleware.transports.dds import DdsTransport

    transport = DdsTransport("test_user", domain_id=DOMAIN, discovery_range="LOCALHOST")
    user = User(transport, lambda: None)
    user.advance = lambda: _wait(user)
    yield user
    transport.close()


def _wait(user: User) -> None:
    user.state_came.wait(0.02)
    user.state_came.clear()


@contextlib.contextmanager
def _on_memory(request: pytest.FixtureRequest) -> Iterator[User]:
    """One thread, one step at a time."""
    robot = Lockstep(load_settings(find_configuration(ROBOT)))
    yield User(MemoryTransport(robot.bus), robot.cycle)


@contextlib.contextmanager
def _on_dds(request: pytest.FixtureRequest) -> Iterator[User]:
    """Two processes, and this one as the user; simulated time is patient."""
    processes, robot = request.getfixturevalue("processes"), request.getfixturevalue("patient_robot")
    user = request.getfixturevalue("dds_user")
    processes.start("mock", robot, "--patient")
    processes.start("run", robot, "--use-sim-time")
    yield user


@contextlib.contextmanager
def _on_ros2(request: pytest.FixtureRequest) -> Iterator[User]:
    """The two executables of ROS 2, and this process as the user, on rclpy too."""
    request.getfixturevalue("monkeypatch").setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    participants = Ros2Participants(DOMAIN)
    user = User(participants.transport("test_user"), lambda: None, is_omitted)
    user.advance = lambda: _wait(user)
    processes, robot = request.getfixturevalue("processes"), request.getfixturevalue("patient_robot")
    for main, parameter in (("mock_main", "patient:=true"), ("main", "use_sim_time:=true")):
        processes.start_node(main, f"robot:={robot}", parameter)
    try:
        yield user
    finally:
        processes.stop_all()
        user.transport.close()
        participants.close()


_STAGES = {"memory": _on_memory, "dds": _on_dds, "ros2": _on_ros2}


@pytest.fixture(params=_STAGES)
def user(request: pytest.FixtureRequest) -> Iterator[User]:
    """A user of a running service with a mock robot, on each transport."""
    with _STAGES[request.param](request) as made:
        yield made
