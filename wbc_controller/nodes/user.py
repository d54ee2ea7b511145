"""User of a robot: requests by topics."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import com_trajectory, encode, joint_trajectory, message
from wbc_controller.middleware.topics import Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.records import Array
from wbc_controller.settings import Settings

_SWAY, _SWING = 0.015, 0.15  # of the centre of mass, m, and of the joints, rad
_HALF_PERIOD = 0.3  # time from one side to the other, s
_DURATION = 4.0  # s


class User:
    """Sends messages to the controller."""

    def __init__(self, settings: Settings, model: RobotModel, topics: Sequence[Endpoint], transport: Transport) -> None:
        drivers = ("joint_states", "odom", "clock", "robot_description")
        incoming = [topic for topic in topics if topic.direction is Direction.IN and topic.key not in drivers]
        self.requests = {(topic.key, topic.subject): topic for topic in incoming}
        self.settings = settings
        self.model = model
        self._publish = {key: transport.advertise(counterpart(topic)) for key, topic in self.requests.items()}

    def send(self, key: str, content: Any, subject: str = "") -> None:
        """Send a message."""
        self.send_bytes(key, encode(content), subject)

    def send_bytes(self, key: str, payload: bytes, subject: str = "") -> None:
        """Send bytes, possibly invalid."""
        self._publish[key, subject](payload)

    def send_text(self, key: str, text: str) -> None:
        """Send a text."""
        self.send(key, message("std_msgs/msg/String", data=text))

    def follow(self, times: Sequence[float], positions: Array) -> None:
        """Send trajectories of the centre of mass through points, (n, 3) in m, at times in s."""
        for name in self.tasks("com"):
            self.send("trajectory", com_trajectory(times, positions), name)

    def move(self, com: Array) -> None:
        """Sway the centre of mass about `com`, (3,) in m, and swing the joints, to reveal frozen values."""
        times = np.arange(_HALF_PERIOD, _DURATION, _HALF_PERIOD)
        sides = (-1.0) ** np.arange(len(times))
        self.follow(times.tolist(), com[None, :] + np.outer(sides, [0.5 * _SWAY, _SWAY, 0.0]))
        for name in self.tasks("posture"):
            joints = tuple(self.settings.tasks[name].joints) or self.model.driven_joints  # type: ignore[union-attr]
            at = [self.model.joints.index(joint) for joint in joints]
            posture = self.model.posture[at] + np.outer(sides, np.full(len(joints), _SWING))
            within = np.clip(posture, self.model.position_lower[at], self.model.position_upper[at])
            self.send("trajectory", joint_trajectory(joints, times.tolist(), within), name)

    def tasks(self, kind: str) -> list[str]:
        """Return the tasks of a type that accept trajectories."""
        named = [name for name, task in self.settings.tasks.items() if task.type == kind]
        return [name for name in named if ("trajectory", name) in self.requests]


def reliable_counterpart(topic: Endpoint) -> Endpoint:
    """Return the counterpart of a topic, with an unlimited queue."""
    return dataclasses.replace(counterpart(topic), qos=dataclasses.replace(topic.qos, depth=1000))
