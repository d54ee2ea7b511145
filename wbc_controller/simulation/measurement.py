"""Measurements of the sensors, and their messages."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware import codec as messages
from wbc_controller.middleware.codec import odometry, pose_with_covariance
from wbc_controller.records import Array
from wbc_controller.simulation.plant import Plant

WORLD_FRAME = "world"  # reference frame of poses
#: Streams in the order of sending; joint states are last, as they trigger a cycle.
STREAMS = ("clock", "odom", "imu", "pose", "joint_states")


@dataclass(slots=True)
class Measurement:
    """Values of all sensors at one instant, before faults change them."""

    true_time: int  # simulated, ns
    stamps: dict[str, int]  # by stream, ns
    names: list[str]
    position: Array  # joints, (nj,) in rad
    velocity: Array  # joints, (nj,) in rad/s
    effort: Array  # joints, (nj,) in N·m
    base: str  # link of the odometry
    pose: Array  # in the world, (7,)
    twist: Array  # in base axes, (6,)
    imu_frame: str
    orientation: Array  # of the IMU, quaternion, (4,)
    angular_velocity: Array  # (3,) in rad/s
    specific_force: Array  # (3,) in m/s²
    absolute: Array  # pose in the world, (7,)
    silent: set[str]  # streams without a message
    pose_sigma: tuple[float, float] = (0.0, 0.0)  # standard deviations of `absolute`, m and rad
    absent: set[str] = field(default_factory=set)  # joints missing in the joint states
    has_velocity: bool = True  # of the joint states

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


def measure(robot: RobotModel, plant: Plant, stamp: int, imu_frame: str) -> Measurement:
    """Measure the present state exactly; `stamp` in ns."""
    q, v = plant.state()
    orientation, angular_velocity, specific_force = plant.imu(imu_frame)
    silent = {"pose"} if robot.floating_base else {"odom", "pose"}  # poses have a lower rate
    return Measurement(
        true_time=stamp,
        stamps=dict.fromkeys(STREAMS, stamp),
        names=list(robot.joints),
        position=q[robot.q_index],
        velocity=v[robot.v_index],
        effort=robot.actuation.at_joints(plant.applied_torques),
        base=robot.base_link,
        pose=q[:7],
        twist=v[:6],
        imu_frame=imu_frame,
        orientation=orientation,
        angular_velocity=angular_velocity,
        specific_force=specific_force,
        absolute=np.array(q[:7]),
        silent=silent,
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
