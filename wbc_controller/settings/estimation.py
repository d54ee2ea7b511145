"""Settings of the base estimator."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import NonNegative, Positive, Section


class EstimationSettings(Section):
    """What is estimated: the floating base, from an IMU, the joints and the contacts; and forces beside the model."""

    live = ("disturbance", "disturbance_time", "disturbance_share")

    base_state: Literal["odom", "imu"] = Field(
        "odom",
        description="odom: pose and twist of the base come on the topic `odom`. imu: they are estimated in each cycle "
        "from the topic `imu`, the joints, and the contacts that hold.",
    )
    imu_frame: str = Field(
        "",
        max_length=255,
        description="Frame of the IMU in the URDF, whose axes its data have; empty for the base link.",
    )
    gyroscope_noise: Annotated[Positive, Field(le=1.0)] = Field(
        2.0e-4, description="Density of the gyroscope's noise, rad/s/√Hz; data sheets give it in °/s/√Hz."
    )
    accelerometer_noise: Annotated[Positive, Field(le=10.0)] = Field(
        2.0e-3, description="Density of the accelerometer's noise, m/s²/√Hz; data sheets give it in µg/√Hz."
    )
    gyroscope_bias_walk: Annotated[Positive, Field(le=1.0)] = Field(
        1.0e-5, description="Density of the walk of the gyroscope's bias, rad/s²/√Hz."
    )
    accelerometer_bias_walk: Annotated[Positive, Field(le=10.0)] = Field(
        1.0e-4, description="Density of the walk of the accelerometer's bias, m/s³/√Hz."
    )
    accelerometer_bias: Annotated[Positive, Field(le=10.0)] = Field(
        0.05, description="The accelerometer's bias at the start, one standard deviation, m/s²."
    )
    contact_noise: Annotated[Positive, Field(le=10.0)] = Field(
        0.01,
        description="Density of the velocity of a contact that holds, m/s/√Hz: creep of soles and ground. With the "
        "default a sole that slides at 0.3 m/s is not excluded; with 0.001 it is.",
    )
    joint_position_noise: NonNegative = Field(
        1.0e-3, le=1.0, description="Noise of the joint positions, one standard deviation, rad."
    )
    contact_position_noise: Annotated[Positive, Field(le=1.0)] = Field(
        1.0e-3,
        description="What moves a contact point beside the joints, such as soft soles, one standard deviation, m.",
    )
    settling: Annotated[Positive, Field(ge=0.1, le=60.0)] = Field(
        0.5, description="Time for which the robot stands still at the start, while gravity and biases are found, s."
    )
    stillness: Annotated[Positive, Field(le=10.0)] = Field(
        0.05, description="Largest standard deviation of the angular velocity in that time, rad/s."
    )
    contact_force_on: Annotated[Positive, Field(le=1.0)] = Field(
        0.05,
        description="Force along a contact's normal above which it holds, by a sensor there, as a share of the weight.",
    )
    contact_force_off: NonNegative = Field(
        0.025, le=1.0, description="Force below which it does not hold any more; at most contact_force_on."
    )
    contact_timeout: Annotated[Positive, Field(ge=0.005, le=10.0)] = Field(
        0.1, description="Age from which a measured contact force decides nothing, s."
    )
    absolute_pose: bool = Field(
        False,
        description="Whether absolute poses of the robot, from motion capture or SLAM, are read from the topic `pose`: "
        "the world is theirs then, and there is no estimate until they have come.",
    )
    pose_frame: str = Field(
        "", max_length=255, description="Frame of the robot whose poses these are; empty for the base link."
    )
    pose_noise: Annotated[Positive, Field(ge=1.0e-4, le=10.0)] = Field(
        0.002, description="Least standard deviation of their position, m: a covariance of zeros is unknown."
    )
    pose_turn_noise: Annotated[Positive, Field(ge=1.0e-4, le=3.0)] = Field(
        0.005, description="Least standard deviation of their heading, rad."
    )
    joint_velocity: Literal["measured", "differentiated"] = Field(
        "measured",
        description="measured: velocities of the joints come with their positions. differentiated: they are computed "
        "from positions and stamps, for robots that measure none; those that come are ignored.",
    )
    joint_velocity_time: Annotated[Positive, Field(ge=5.0e-4, le=0.05)] = Field(
        0.004, description="Time constant of that filter, s; velocities are late by about twice as much."
    )
    disturbance: Literal["never", "imu", "always"] = Field(
        "imu",
        description="Whether generalized forces that the model lacks (friction, wrong torques and masses) are "
        "estimated and taken into account. imu: where base_state is imu.",
    )
    disturbance_time: Annotated[Positive, Field(ge=0.02, le=60.0)] = Field(
        0.2, description="Time constant with which they are estimated, s."
    )
    disturbance_share: Annotated[Positive, Field(le=1.0)] = Field(
        0.2, description="Their largest size, as a share of the joints' torques and of the robot's weight."
    )

    torque_filter: Literal["never", "imu", "always"] = Field(
        "imu",
        description="Whether the torques sent follow those of the solutions with a delay, so that noise of the sensors "
        "does not reach the motors. imu: where base_state is imu.",
    )
    torque_filter_time: Annotated[Positive, Field(ge=5.0e-4, le=0.05)] = Field(
        0.008, description="Time constant of that filter, s."
    )

    @model_validator(mode="after")
    def _hysteresis(self) -> EstimationSettings:
        if not self.contact_force_off <= self.contact_force_on:
            raise ValueError(
                f"contact_force_off = {self.contact_force_off}: it is at most contact_force_on, {self.contact_force_on}"
            )
        return self
