"""Test doubles of the robot."""

import contextlib
import gc
import math
import os
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.controller.build.estimation import imu_frame
from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import Template, encode, torques
from wbc_controller.middleware.topics import Endpoint, counterpart
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.nodes.realtime import apply_realtime
from wbc_controller.nodes.ros2.installation import refuse_mixed_installations
from wbc_controller.settings import Settings
from wbc_controller.settings.service import RealtimeSettings
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import Measurement

TRANSPORTS = ("dds", "rclpy")
_BASE = ("odom", "imu")
#: Amplitude, rad, and angular frequency, rad/s, of the joints' sway, so that states differ.
_SWAY, _PACE = 5.0e-4, 2.0 * math.pi


def open_transport(kind: str, node: str, domain: int) -> contextlib.AbstractContextManager[Transport]:
    """Open a transport on a domain of this computer.

    Raises:
        ConfigurationError: if the transport is unknown, rclpy cannot be imported, or two ROS 2 would be mixed.
        TransportError: if the transport cannot be started.
    """
    require_known(kind, TRANSPORTS, "unknown transport")
    if kind == "dds":
        from wbc_controller.middleware.transports.dds import DdsTransport

        return contextlib.closing(DdsTransport(node, domain_id=domain, discovery_range="LOCALHOST"))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # rclpy reads only this variable
    refuse_mixed_installations()
    try:
        from wbc_controller.nodes.ros2.process import node_without_services
    except ImportError as error:
        raise ConfigurationError(
            f"transport rclpy: ROS 2 not found ({error}); source it, with its Python version, or install its wheels "
            "(docs/ros2.md), or use --transport dds"
        ) from error
    return node_without_services(node, domain)


class StandingRobot:
    """Sends the states of a standing and slightly swaying robot, independently of the torques."""

    def __init__(self, model: RobotModel, settings: Settings, transport: Transport, topics: Sequence[Endpoint]) -> None:
        standing = Measurement(model, Plant(model, settings), 0, imu_frame(settings, model))
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
        """Send states at the configured rate until the event is set; skip states late by more than a period."""
        gc.collect()
        gc.freeze()
        began, count = time.monotonic(), 0
        while not stop.is_set():
            time.sleep(max(0.0, began + count * self._period - time.monotonic()))
            stamp = time.time_ns()
            phase = _PACE * 1.0e-9 * stamp
            position = self._position + _SWAY * math.sin(phase)
            velocity = np.full_like(self._position, _SWAY * _PACE * math.cos(phase))
            for stream, template in self._base.items():
                self._publish[stream](template.write(stamp))
            self._publish["joint_states"](self._joint_states.write(stamp, position, velocity))
            count = max(count + 1, math.ceil((time.monotonic() - began) / self._period))


def echo(kind: str, domain: int, topics: Sequence[Endpoint], size: int, stop: Any, realtime: RealtimeSettings) -> None:
    """Answer each joint state immediately with zero torques, and with its own bytes as joint commands.

    Runs in its own process.
    """
    end_with_parent()
    apply_realtime(realtime)
    payload = encode(torques(np.zeros(size)))
    by_key = {topic.key: topic for topic in topics}
    with open_transport(kind, "bench_echo", domain) as transport:
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
