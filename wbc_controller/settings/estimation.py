"""Settings of the estimators."""

from typing import Literal

from pydantic import model_validator

from wbc_controller.settings.values import NonNegative, Positive, Section, key


class EstimationSettings(Section):
    """Estimation of the floating base and of the disturbance (docs/estimation.md)."""

    live = ("disturbance", "disturbance_time", "disturbance_share")

    base_state: Literal["odom", "imu"] = key(
        "odom",
        "Source of the base's pose and twist: topic `odom`, or an estimate from the topic `imu`, joints and contacts.",
    )
    imu_frame: str = key("", "URDF frame with the axes of the IMU data; empty for the base link.", max_length=255)
    gyroscope_noise: Positive = key(2.0e-4, "Noise density of the gyroscope, rad/s/√Hz (data sheets: °/s/√Hz).", le=1.0)
    accelerometer_noise: Positive = key(
        2.0e-3, "Noise density of the accelerometer, m/s²/√Hz (data sheets: µg/√Hz).", le=10.0
    )
    gyroscope_bias_walk: Positive = key(1.0e-5, "Random walk density of the gyroscope bias, rad/s²/√Hz.", le=1.0)
    accelerometer_bias_walk: Positive = key(1.0e-4, "Random walk density of the accelerometer bias, m/s³/√Hz.", le=10.0)
    accelerometer_bias: Positive = key(0.05, "Standard deviation of the initial accelerometer bias, m/s².", le=10.0)
    contact_noise: Positive = key(
        1.0e-3, "Noise density of the contact velocity (creep), m/s/√Hz. Large values hide slip.", le=10.0
    )
    joint_position_noise: NonNegative = key(1.0e-3, "Standard deviation of the joint positions, rad.", le=1.0)
    contact_position_noise: Positive = key(
        1.0e-3, "Standard deviation of contact positions due to compliance, such as soft soles, m.", le=1.0
    )
    settling: Positive = key(0.5, "Standstill at the start for the estimate of gravity and biases, s.", ge=0.1, le=60.0)
    stillness: Positive = key(
        0.05, "Largest standard deviation of the angular velocity during this standstill, rad/s.", le=10.0
    )
    contact_force_on: Positive = key(
        0.05, "Measured normal force above which a contact is detected, as a share of the weight.", le=1.0
    )
    contact_force_off: NonNegative = key(
        0.025, "Normal force below which the detection ends; at most `contact_force_on`.", le=1.0
    )
    contact_timeout: Positive = key(0.1, "Age from which a measured contact force is ignored, s.", ge=0.005, le=10.0)
    absolute_pose: bool = key(
        False, "Use absolute poses from the topic `pose` (motion capture, SLAM), which define the world."
    )
    pose_frame: str = key("", "Robot frame of these poses; empty for the base link.", max_length=255)
    pose_noise: Positive = key(
        0.002, "Smallest standard deviation of their position, m; used if the covariance is zero.", ge=1.0e-4, le=10.0
    )
    pose_turn_noise: Positive = key(0.005, "Smallest standard deviation of their heading, rad.", ge=1.0e-4, le=3.0)
    joint_velocity: Literal["measured", "differentiated"] = key(
        "measured", "differentiated: from positions and timestamps."
    )
    joint_velocity_time: Positive = key(
        0.004, "Time constant of the differentiation, s; the delay is about twice as long.", ge=5.0e-4, le=0.05
    )
    disturbance: Literal["never", "imu", "always"] = key(
        "imu",
        "Estimate and compensate forces outside the model (friction, wrong torques and masses). imu: if "
        "`base_state` is imu.",
    )
    disturbance_time: Positive = key(0.2, "Time constant of the disturbance estimate, s.", ge=0.02, le=60.0)
    disturbance_share: Positive = key(
        0.2, "Bound of the disturbance estimate, as a share of the joint torques and of the weight.", le=1.0
    )

    torque_filter: Literal["never", "imu", "always"] = key("imu", "Low-pass filter of the torques; imu: likewise.")
    torque_filter_time: Positive = key(0.008, "Time constant of the torque filter, s.", ge=5.0e-4, le=0.05)

    @model_validator(mode="after")
    def _hysteresis(self) -> "EstimationSettings":
        on, off = self.contact_force_on, self.contact_force_off
        if not off <= on:
            raise ValueError(f"contact_force_off = {off}: must not exceed contact_force_on = {on}")
        return self
