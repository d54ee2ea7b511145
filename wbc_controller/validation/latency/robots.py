"""Replacements of the robot at the other end of the topics: a robot that only sends states, and an echo."""

import contextlib
import gc
import math
import os
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from wbc_controller.controller.build.estimation import imu_frame
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import encode, torques
from wbc_controller.middleware.message_layout import Template
from wbc_controller.middleware.topics import Endpoint, counterpart
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.realtime import apply_realtime
from wbc_controller.nodes.ros2.installation import refuse_mixed_installations
from wbc_controller.settings import RealtimeSettings, Settings
from wbc_controller.simulation.measurement import measure
from wbc_controller.simulation.plant import Plant

#: The transports on which can be measured.
TRANSPORTS = ("dds", "rclpy")
#: The streams of the base.
_BASE = ("odom", "imu")
#: Amplitude of the joints' sway, rad, and its angular frequency, rad/s: so that no two states are equal.
_SWAY, _PACE = 5.0e-4, 2.0 * math.pi


@contextlib.contextmanager
def opened(kind: str, node: str, domain: int) -> Iterator[Transport]:
    """A transport on a domain of this computer.

    Raises:
        ConfigurationError: if there is no such transport, or rclpy is not importable, or two ROS 2 would be mixed.
        TransportError: if the transport cannot be started.
    """
    if kind not in TRANSPORTS:
        raise ConfigurationError(f"transport {kind!r}: there is none of this name; {valid_choices(kind, TRANSPORTS)}")
    if kind == "dds":
        from wbc_controller.middleware.transports.dds import DdsTransport

        transport = DdsTransport(node, domain_id=domain, discovery_range="LOCALHOST")
        with contextlib.closing(transport):
            yield transport
        return
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # rclpy takes it from there alone
    refuse_mixed_installations()
    try:
        from wbc_controller.nodes.ros2.process import node_without_services
    except ImportError as error:
        raise ConfigurationError(
            f"transport rclpy: this Python finds no ROS 2 ({error}); source it first, with the Python it was made for, "
            "or install its wheels (docs/ros2.md), or measure with --transport dds"
        ) from error
    with node_without_services(node, domain) as alone:
        yield alone


class StandingRobot:
    """Sends the states of a robot that stands and sways a little, whatever torques come."""

    def __init__(self, model: RobotModel, settings: Settings, transport: Transport, topics: Sequence[Endpoint]) -> None:
        """Open the topics of its states."""
        standing = measure(model, Plant(model, settings), 0, imu_frame(settings, model))
        self._period = 1.0 / settings.control.rate
        self._position = standing.position
        self._joint_states = Template(standing.message("joint_states"), ["position"], ["velocity"])
        self._publish = {
            topic.key: transport.advertise(counterpart(topic))
            for topic in topics
            if topic.key in ("joint_states", *_BASE) and topic.key not in standing.silent
        }
        self._base = {stream: Template(standing.message(stream)) for stream in _BASE if stream in self._publish}

    def run(self, stop: threading.Event) -> None:
        """Send states at the rate of the configuration until the event is set.

        States that are late by more than a period are left out, as a robot leaves them out.
        """
        gc.collect()
        gc.freeze()  # as in the control loop
        began, count = time.monotonic(), 0
        while not stop.is_set():
            time.sleep(max(0.0, began + count * self._period - time.monotonic()))
            self._send(time.time_ns())
            count = max(count + 1, math.ceil((time.monotonic() - began) / self._period))

    def _send(self, stamp: int) -> None:
        phase = _PACE * 1.0e-9 * stamp
        velocity = np.full_like(self._position, _SWAY * _PACE * math.cos(phase))
        for stream, template in self._base.items():
            self._publish[stream](template.write(stamp))
        self._publish["joint_states"](
            self._joint_states.write(stamp, self._position + _SWAY * math.sin(phase), velocity)
        )


def echo(kind: str, domain: int, topics: Sequence[Endpoint], size: int, stop: Any, realtime: RealtimeSettings) -> None:
    """Answer each joint state at once with torques of zero, and with its own bytes in place of joint commands.

    Runs in a process of its own.
    """
    apply_realtime(realtime)
    payload = encode(torques(np.zeros(size)))
    by_key = {topic.key: topic for topic in topics}
    with opened(kind, "bench_echo", domain) as transport:
        answer = [transport.advertise(by_key[key]) for key in ("effort", "joint_commands")]

        def receive(state: bytes) -> None:
            answer[0](payload)
            answer[1](state)

        if "odom" in by_key:
            transport.subscribe(by_key["odom"], lambda state: None)
        transport.subscribe(by_key["joint_states"], receive)
        gc.collect()
        gc.freeze()
        stop.wait()
