"""Errors of the estimate of a standing robot."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.stats import chi2

from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.records import Array
from wbc_controller.settings.service import SensorQuality
from wbc_controller.simulation.sensors import PARTS
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

_SAMPLING_PERIOD = 0.1  # s
_SIGNIFICANCE = 0.05  # probability outside the consistency bounds
_CREEP = 8.0e-5  # creep of contact points in the mock robot, m/s/√Hz


@dataclass(frozen=True, slots=True)
class StandingErrors:
    """Errors of one robot."""

    tilt: float  # RMS of roll and pitch error, rad
    height: float  # RMS error of the height since the start, m
    velocity: float  # RMS error of the linear velocity, m/s
    drift: float  # growth of the horizontal error since the start, m per minute
    observable_nees: Array  # NEES of tilt and velocity, 5 degrees of freedom, (n,)
    drifting_nees: Array  # NEES of heading and position since the start, 4 degrees of freedom, (n,)
    ended: str = ""  # reason of an early end


def sensor_settings(sensors: SensorQuality) -> dict[str, Any]:
    """Return filter settings from the data sheets of the sensors; empty for `ideal` ones."""
    parts = PARTS.get(sensors)
    if parts is None:
        return {}
    return {
        "estimation.gyroscope_noise": parts.gyroscope_noise,
        "estimation.accelerometer_noise": parts.accelerometer_noise,
        "estimation.gyroscope_bias_walk": parts.gyroscope_walk,
        "estimation.accelerometer_bias_walk": parts.accelerometer_walk,
        "estimation.accelerometer_bias": parts.accelerometer_bias,
        # Rounding errors are uniform within half a step.
        "estimation.joint_position_noise": math.hypot(
            parts.encoder_noise, parts.encoder_resolution / math.sqrt(12.0), parts.encoder_offset
        ),
        "estimation.contact_noise": _CREEP,
    }


def stand(robot: str, sensors: SensorQuality, seed: int, seconds: float) -> StandingErrors:
    """Measure the errors of a standing robot; the filter has the data of its sensors."""
    own = {"estimation.base_state": "imu", "mock.sensors": sensors, "mock.sensor_seed": seed}
    trial = EstimationTrial(robot, {**sensor_settings(sensors), **own})
    samples: list[tuple[Array, Array]] = []  # errors and covariances
    every = max(1, round(_SAMPLING_PERIOD * trial.settings.control.rate))
    ended, cycles = "", itertools.count(1)

    def observe() -> None:
        if next(cycles) % every == 0:
            samples.append(error_of(trial))

    try:
        trial.stand()
        trial.run(seconds, observe)
    except WbcError as error:
        ended = str(error)
    if not samples:
        nothing = np.zeros(0)
        return StandingErrors(np.nan, np.nan, np.nan, np.nan, nothing, nothing, ended)
    found, covariances = (np.array(each) for each in zip(*samples, strict=True))
    since = found - found[0]
    minutes = max(len(found) - 1, 1) * _SAMPLING_PERIOD / 60.0
    observable, drifting = [0, 1, 3, 4, 5], [2, 6, 7, 8]
    return StandingErrors(
        tilt=float(np.sqrt(np.mean(np.sum(found[:, :2] ** 2, axis=1)))),
        height=float(np.sqrt(np.mean(since[:, 8] ** 2))),
        velocity=float(np.sqrt(np.mean(np.sum(found[:, 3:6] ** 2, axis=1)))),
        drift=float(np.linalg.norm(since[-1, 6:8])) / minutes,
        observable_nees=_nees(found, covariances, observable),
        drifting_nees=_nees(since[1:], covariances[1:] - covariances[0], drifting),
        ended=ended,
    )


def error_of(trial: EstimationTrial) -> tuple[Array, Array]:
    """Return the filter's error ξ of rotation, velocity and position, first order, (9,), and its covariance, (9, 9).

    The right-invariant error X̂ X⁻¹ = exp(ξ) has the columns R̂ Rᵀ, v̂ - R̂ Rᵀ v and p̂ - R̂ Rᵀ p at the time of the
    last cycle's state.
    """
    estimator = trial.loop.estimator
    if estimator is None or estimator.filter is None:
        raise ConfigurationError("the robot has no base estimate; required: estimation.base_state: imu")
    model, (q, v), found = trial.controller.model, trial.true_state, estimator.filter
    data, frame = model.pinocchio.createData(), model.frame_id(estimator.imu_frame, "estimation.imu_frame")
    pin.forwardKinematics(model.pinocchio, data, q, v)
    placement = pin.updateFramePlacement(model.pinocchio, data, frame)
    velocity = pin.getFrameVelocity(model.pinocchio, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
    turn = found.rotation @ placement.rotation.T
    error = [pin.log3(turn), found.velocity - turn @ velocity, found.position - turn @ placement.translation]
    return np.concatenate(error), np.array(found.P[:9, :9])


def _nees(errors: Array, covariances: Array, part: list[int]) -> Array:
    pairs = zip(errors[:, part], covariances[:, part][:, :, part], strict=True)
    return np.array([error @ np.linalg.lstsq(P, error, rcond=1e-12)[0] for error, P in pairs])


def consistency(squares: Sequence[Array], freedom: int) -> tuple[float, float]:
    """Return the share of time with the mean NEES within its 95 % bounds, and the normalized mean.

    `squares`: NEES of each run, (n,); the shortest run counts.
    """
    length = min((len(each) for each in squares), default=0)
    if not length:
        return np.nan, np.nan
    runs = len(squares)
    mean = np.mean([each[:length] for each in squares], axis=0)
    low, high = chi2.ppf([_SIGNIFICANCE / 2.0, 1.0 - _SIGNIFICANCE / 2.0], freedom * runs) / runs
    return float(np.mean((mean >= low) & (mean <= high))), float(np.mean(mean)) / freedom
