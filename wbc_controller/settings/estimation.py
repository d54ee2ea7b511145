"""Settings of the estimators."""

from typing import Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import NonNegative, Positive, Section


class EstimationSettings(Section):
    """Estimation of the floating base and of the disturbance (docs/estimation.md)."""

    live = ("disturbance", "disturbance_time", "disturbance_share")

    base_state: Literal["odom", "imu"] = Field(
        "odom",
        description="Source of the base's pose and twist: topic `odom`, or an estimate from the topic `imu`, joints "
        "and contacts.",
    )
    imu_frame: str = Field(
        "", max_length=255, description="URDF frame with the axes of the IMU data; empty for the base link."
    )
    gyroscope_noise: Positive = Field(
        2.0e-4, le=1.0, description="Noise density of the gyroscope, rad/s/√Hz (data sheets: °/s/√Hz)."
    )
    accelerometer_noise: Positive = Field(
        2.0e-3, le=10.0, description="Noise density of the accelerometer, m/s²/√Hz (data sheets: µg/√Hz)."
    )
    gyroscope_bias_walk: Positive = Field(
        1.0e-5, le=1.0, description="Random walk density of the gyroscope bias, rad/s²/√Hz."
    )
    accelerometer_bias_walk: Positive = Field(
        1.0e-4, le=10.0, description="Random walk density of the accelerometer bias, m/s³/√Hz."
    )
    accelerometer_bias: Positive = Field(
        0.05, le=10.0, description="Standard deviation of the initial accelerometer bias, m/s²."
    )
    contact_noise: Positive = Field(
        1.0e-3, le=10.0, description="Noise density of the contact velocity (creep), m/s/√Hz. Large values hide slip."
    )
    joint_position_noise: NonNegative = Field(
        1.0e-3, le=1.0, description="Standard deviation of the joint positions, rad."
    )
    contact_position_noise: Positive = Field(
        1.0e-3, le=1.0, description="Standard deviation of contact positions due to compliance, such as soft soles, m."
    )
    settling: Positive = Field(
        0.5, ge=0.1, le=60.0, description="Standstill at the start for the estimate of gravity and biases, s."
    )
    stillness: Positive = Field(
        0.05, le=10.0, description="Largest standard deviation of the angular velocity during this standstill, rad/s."
    )
    contact_force_on: Positive = Field(
        0.05, le=1.0, description="Measured normal force above which a contact is detected, as a share of the weight."
    )
    contact_force_off: NonNegative = Field(
        0.025, le=1.0, description="Normal force below which the detection ends; at most `contact_force_on`."
    )
    contact_timeout: Positive = Field(
        0.1, ge=0.005, le=10.0, description="Age from which a measured contact force is ignored, s."
    )
    absolute_pose: bool = Field(
        False, description="Use absolute poses from the topic `pose` (motion capture, SLAM), which define the world."
    )
    pose_frame: str = Field("", max_length=255, description="Robot frame of these poses; empty for the base link.")
    pose_noise: Positive = Field(
        0.002,
        ge=1.0e-4,
        le=10.0,
        description="Smallest standard deviation of their position, m; used if the covariance is zero.",
    )
    pose_turn_noise: Positive = Field(
        0.005, ge=1.0e-4, le=3.0, description="Smallest standard deviation of their heading, rad."
    )
    joint_velocity: Literal["measured", "differentiated"] = Field(
        "measured", description="differentiated: from positions and timestamps."
    )
    joint_velocity_time: Positive = Field(
        0.004,
        ge=5.0e-4,
        le=0.05,
        description="Time constant of the differentiation, s; the delay is about twice as long.",
    )
    disturbance: Literal["never", "imu", "always"] = Field(
        "imu",
        description="Estimate and compensate forces outside the model (friction, wrong torques and masses). imu: if "
        "`base_state` is imu.",
    )
    disturbance_time: Positive = Field(
        0.2, ge=0.02, le=60.0, description="Time constant of the disturbance estimate, s."
    )
    disturbance_share: Positive = Field(
        0.2, le=1.0, description="Bound of the disturbance estimate, as a share of the joint torques and of the weight."
    )

    torque_filter: Literal["never", "imu", "always"] = Field(
        "imu", description="Low-pass filter of the torques; imu: likewise."
    )
    torque_filter_time: Positive = Field(
        0.008, ge=5.0e-4, le=0.05, description="Time constant of the torque filter, s."
    )

    @model_validator(mode="after")
    def _hysteresis(self) -> "EstimationSettings":
        on, off = self.contact_force_on, self.contact_force_off
        if not off <= on:
            raise ValueError(f"contact_force_off = {off}: must not exceed contact_force_on = {on}")
        return self
