"""Measurements of the sensors, their messages, and errors of sensors and motors (sources: docs/estimation.md)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.estimation import pose_frame
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.middleware import codec as messages
from wbc_controller.middleware.codec import odometry, pose_with_covariance
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.service import SensorQuality
from wbc_controller.simulation.plant import Plant

WORLD_FRAME = "world"  # reference frame of poses
#: Streams in the order of sending; joint states are last, as they trigger a cycle.
STREAMS = ("clock", "odom", "imu", "pose", "joint_states")
_DEGREE, _G = math.pi / 180.0, 9.80665
_SAME = 1e-9  # resolution of times, s


class Measurement:
    """Values of all sensors at one instant, before faults change them."""

    def __init__(self, robot: RobotModel, plant: Plant, stamp: int, imu_frame: str) -> None:
        """Measure the present state exactly; `stamp` in ns."""
        q, v = plant.state()
        self.true_time = stamp  # simulated, ns
        self.stamps = dict.fromkeys(STREAMS, stamp)  # by stream, ns
        self.names, self.absent = list(robot.joints), set[str]()  # joints, and joints missing in the joint states
        self.position: Array = q[robot.q_index]  # joints, (nj,) in rad
        self.velocity: Array = v[robot.v_index]  # joints, (nj,) in rad/s
        self.effort: Array = robot.actuation.at_joints(plant.applied_torques)  # joints, (nj,) in N·m
        self.has_velocity = True  # of the joint states
        self.base = robot.base_link  # link of the odometry
        self.pose, self.twist = q[:7], v[:6]  # in the world, (7,), and in base axes, (6,)
        self.imu_frame = imu_frame
        #: Of the IMU: quaternion, (4,), angular velocity, (3,) in rad/s, and specific force, (3,) in m/s².
        self.orientation, self.angular_velocity, self.specific_force = plant.imu(imu_frame)
        self.absolute = np.array(q[:7])  # pose in the world, (7,)
        self.pose_sigma = 0.0, 0.0  # standard deviations of `absolute`, m and rad
        #: Streams without a message; poses have a lower rate.
        self.silent = {"pose"} if robot.floating_base else {"odom", "pose"}

    def message(self, stream: str) -> Any:
        """Return the message of a stream."""
        stamp = self.stamps[stream]
        if stream == "clock":
            return messages.message("rosgraph_msgs/msg/Clock", clock=messages.time_fields(stamp))
        if stream == "odom":
            return odometry(stamp, WORLD_FRAME, self.base, self.pose, self.twist)
        if stream == "imu":
            return imu_message(stamp, self.imu_frame, self.orientation, self.angular_velocity, self.specific_force)
        if stream == "pose":
            return pose_with_covariance(stamp, WORLD_FRAME, self.absolute, *self.pose_sigma)
        present = [name not in self.absent for name in self.names]
        return messages.message(
            "sensor_msgs/msg/JointState",
            header=messages.header(stamp),
            name=[name for name in self.names if name not in self.absent],
            position=self.position[present],
            velocity=self.velocity[present] if self.has_velocity else np.zeros(0),
            effort=self.effort[present],
        )


def imu_message(stamp: int, frame: str, attitude: Array, angular_velocity: Array, specific_force: Array) -> Any:
    """Return an Imu message without covariances."""
    return messages.message(
        "sensor_msgs/msg/Imu",
        header=messages.header(stamp, frame),
        orientation=attitude,
        angular_velocity=angular_velocity,
        linear_acceleration=specific_force,
    )


@dataclass(frozen=True, slots=True)
class Parts:
    """Errors of IMU, encoders and motors; biases and offsets are standard deviations."""

    gyroscope_noise: float  # rad/s/√Hz
    gyroscope_bias: float  # initial, rad/s
    gyroscope_walk: float  # rad/s²/√Hz
    accelerometer_noise: float  # m/s²/√Hz
    accelerometer_bias: float  # initial, m/s²
    accelerometer_walk: float  # m/s³/√Hz
    encoder_resolution: float  # rad (m for prismatic joints, likewise below)
    encoder_noise: float  # standard deviation, rad
    encoder_offset: float  # per joint, rad
    velocity_noise: float  # standard deviation, rad/s
    torque_error: float  # share of each motor's torque


_PRESETS: tuple[SensorQuality, ...] = ("good", "cheap")
_VALUES = {  # of the presets
    "gyroscope_noise": (0.007 * _DEGREE, 0.014 * _DEGREE),
    "gyroscope_bias": (0.1 * _DEGREE, 1.0 * _DEGREE),
    "gyroscope_walk": (1.0e-5, 1.0e-4),
    "accelerometer_noise": (120.0e-6 * _G, 175.0e-6 * _G),
    "accelerometer_bias": (2.0e-3 * _G, 20.0e-3 * _G),
    "accelerometer_walk": (1.0e-4, 1.0e-3),
    "encoder_resolution": (2.0 * math.pi / 2**19, 2.0 * math.pi / 2**14),
    "encoder_noise": (5.0e-5, 2.0e-4),
    "encoder_offset": (5.0e-4, 5.0e-3),
    "velocity_noise": (0.005, 0.05),
    "torque_error": (0.02, 0.1),
}
#: Parts by preset; ``ideal`` has none.
PARTS = {preset: Parts(**{part: row[i] for part, row in _VALUES.items()}) for i, preset in enumerate(_PRESETS)}


class ImperfectSensors:
    """Sensors with constant errors, drawn once, and noise, drawn in every period."""

    def __init__(self, parts: Parts, robot: RobotModel, period: float, seed: int) -> None:
        self._parts = parts
        self._rng = rng = np.random.default_rng(seed)
        self._gyroscope_bias = parts.gyroscope_bias * rng.standard_normal(3)
        self._accelerometer_bias = parts.accelerometer_bias * rng.standard_normal(3)
        self._offsets = parts.encoder_offset * rng.standard_normal(robot.nj)
        self._gains = 1.0 + parts.torque_error * rng.standard_normal(robot.na)
        self._noise, self._drawn = np.zeros(12 + 2 * robot.nj), -1
        # From densities to samples (means over a period) and steps of random walks.
        self._per_sample, self._per_step = 1.0 / math.sqrt(period), math.sqrt(period)

    def measure(self, measured: Measurement) -> None:
        """Replace true values by measured ones, reproducibly."""
        parts, count = self._parts, len(measured.position)
        if measured.true_time != self._drawn:
            self._drawn, self._noise = measured.true_time, self._rng.standard_normal(len(self._noise))
            self._gyroscope_bias += parts.gyroscope_walk * self._per_step * self._noise[:3]
            self._accelerometer_bias += parts.accelerometer_walk * self._per_step * self._noise[3:6]
        turning, force, seen, speed = np.split(self._noise[6:], (3, 6, 6 + count))
        measured.angular_velocity += self._gyroscope_bias
        measured.angular_velocity += parts.gyroscope_noise * self._per_sample * turning
        measured.specific_force += self._accelerometer_bias
        measured.specific_force += parts.accelerometer_noise * self._per_sample * force
        position = measured.position + self._offsets + parts.encoder_noise * seen
        measured.position = parts.encoder_resolution * np.round(position / parts.encoder_resolution)
        measured.velocity = measured.velocity + parts.velocity_noise * speed

    def torques(self, tau: Array) -> Array:
        """Return the motor torques for commanded ones, (na,) in N·m."""
        return self._gains * tau


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
