"""Absolute poses with noise."""

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.estimation import pose_frame
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.simulation.measurement import Measurement

_SAME = 1e-9  # resolution of times, s


class PoseSource:
    """Measures a robot frame at the rate `mock.pose_rate`."""

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        mock = settings.mock
        self._pinocchio, self._data = model.pinocchio, model.pinocchio.createData()
        self._frame = model.frame_id(pose_frame(settings, model), "estimation.pose_frame")
        self._period = 1.0 / mock.pose_rate
        self._noise = mock.pose_noise, mock.pose_turn_noise
        self._rng = np.random.default_rng(mock.sensor_seed)
        self._due = 0.0

    def measure(self, measured: Measurement, q: Array, time: float) -> None:
        """Measure the frame in the true configuration, (nq,), if due at a time, s."""
        if time < self._due - _SAME:
            return
        self._due = max(self._due + self._period, time)
        pin.forwardKinematics(self._pinocchio, self._data, q)
        placed = pin.updateFramePlacement(self._pinocchio, self._data, self._frame)
        noise = self._rng.standard_normal(6)
        turned = pin.exp3(self._noise[1] * noise[3:]) @ placed.rotation
        place = placed.translation + self._noise[0] * noise[:3]
        measured.absolute = np.concatenate([place, quaternion_of(turned)])
        measured.pose_sigma = self._noise
        measured.silent.discard("pose")
