"""Absolute poses of motion capture or SLAM: at a rate of their own, noisy, and late."""

from collections import deque

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.estimation import pose_frame
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.simulation.measurement import Measurement

#: Times closer than this are the same, s.
_SAME = 1e-9


class PoseSource:
    """Measures a frame of the robot at the rate of `mock.pose_rate`, and keeps each message until it is due."""

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        """Find the frame.

        Raises:
            ConfigurationError: if the robot has no such frame.
        """
        mock = settings.mock
        self._pinocchio, self._data = model.pinocchio, model.pinocchio.createData()
        self._frame = model.frame_id(pose_frame(settings, model), "estimation.pose_frame")
        self._period, self._delay = 1.0 / mock.pose_rate, mock.pose_delay
        self._noise = mock.pose_noise, mock.pose_turn_noise
        self._rng = np.random.default_rng(mock.sensor_seed)
        self._due = 0.0
        self._late: deque[tuple[float, int, bytes]] = deque()

    def measure(self, measured: Measurement, q: Array, time: float) -> None:
        """Measure the frame in a true configuration, (nq,), if it is due at the simulated time, s."""
        if time < self._due - _SAME:
            return
        self._due = max(self._due + self._period, time)
        pin.forwardKinematics(self._pinocchio, self._data, q)
        placed = pin.updateFramePlacement(self._pinocchio, self._data, self._frame)
        noise = self._rng.standard_normal(6)
        turned = pin.exp3(self._noise[1] * noise[3:]) @ placed.rotation
        place = placed.translation + self._noise[0] * noise[:3]
        measured.absolute = np.concatenate([place, quaternion_of(turned)])
        measured.vagueness = self._noise
        measured.silent.discard("pose")

    def late(self, time: float, taken: int, payload: bytes | None) -> list[tuple[int, bytes]]:
        """Keep a new message, if any, and return the due ones, each with the true time of its content, ns."""
        if payload is not None:
            self._late.append((time + self._delay, taken, payload))
        due = []
        while self._late and self._late[0][0] <= time + _SAME:
            due.append(self._late.popleft()[1:])
        return due
