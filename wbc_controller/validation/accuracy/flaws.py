"""Errors of the centre of mass by flaws."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.records import Array
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.actuators import ActuatorDelay, ActuatorGain, ActuatorLag
from wbc_controller.simulation.faults.base_sensors import ImuNoise
from wbc_controller.simulation.faults.fault import LONGEST, Fault
from wbc_controller.simulation.faults.joint_sensors import JointNoise
from wbc_controller.simulation.faults.world import MassError, SoftFloor
from wbc_controller.validation.accuracy.estimation_trial import Changes, EstimationTrial

SWAY, SQUAT, _BEAT = 0.03, 0.05, 1.5  # amplitudes, m, and time between points, s
CHATTER = 8.0  # Hz


@dataclass(frozen=True, slots=True)
class Flaw:
    """A difference between robot and model."""

    name: str
    changes: Changes = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()  # of the mock robot
    gain: float = 1.0  # factor of all torques
    force_sensors: bool = False  # True for force sensors at the contacts


def _always(kind: type[Fault], **parameters: Any) -> tuple[Fault, ...]:
    return (kind(duration=LONGEST, **parameters),)


#: Noise of an IMU's samples, and its density at 500 samples per second.
_SIGMA = 0.05
_DENSITY = _SIGMA * 0.002**0.5
#: Rows of the table. Noise in a data sheet is given to the filter.
FLAWS = (
    Flaw("none"),
    Flaw("torques 20 ms late", faults=_always(ActuatorDelay, delay=0.02)),
    Flaw("torques lag by 20 ms", faults=_always(ActuatorLag, time_constant=0.02)),
    Flaw(
        "encoder noise 5e-3 rad",
        {"estimation.joint_position_noise": 0.005},
        _always(JointNoise, sigma=0.005, velocity_sigma=1.0e-4),
    ),
    Flaw(
        "joint velocity noise 0.2 rad/s",
        {"estimation.joint_velocity": "differentiated"},
        _always(JointNoise, sigma=1.0e-5, velocity_sigma=0.2),
    ),
    Flaw("velocity noise 0.2 rad/s, as measured", faults=_always(JointNoise, sigma=1.0e-5, velocity_sigma=0.2)),
    Flaw(
        "IMU noise 0.05 rad/s, m/s²",
        {"estimation.gyroscope_noise": _DENSITY, "estimation.accelerometer_noise": _DENSITY},
        _always(ImuNoise, sigma=_SIGMA),
    ),
    Flaw(
        "slope 10°, force sensors",  # lowered onto the slope, one foot after the other
        {"mock.floor_normal": [0.0, float(np.sin(np.deg2rad(10))), float(np.cos(np.deg2rad(10)))]},
        force_sensors=True,
    ),
    Flaw("100 Hz", {"control.rate": 100.0}),
    Flaw("masses 20 % too small", faults=_always(MassError, share=0.2)),
    Flaw("masses 20 % too large", faults=_always(MassError, share=-0.2)),
    Flaw("torques 20 % too small", gain=0.8),
    Flaw("joint friction 2 N·m", {"mock.joint_friction": 2.0}),
    Flaw("joint friction 5 N·m", {"mock.joint_friction": 5.0}),
    Flaw("soft ground, time constant 0.15 s", faults=_always(SoftFloor, time_constant=0.15)),
)


@dataclass(frozen=True, slots=True)
class FlawErrors:
    """Errors caused by a flaw; NaN after an early end."""

    sway: float  # largest error of the centre of mass, m
    squat: float  # during the squat, m
    chatter: float  # largest RMS torque of an actuator above `CHATTER`, as a share of its limit
    ended: str = ""  # reason of an early end


def measure_flaw(
    robot: str, name: str, sensors: str = "good", disturbance: str = "imu", known_friction: bool = False
) -> FlawErrors:
    """Compare the true centre of mass with the references of a sway and a squat.

    `known_friction` puts the joint friction of the flaw into ``robot.friction``.
    """
    flaw = next(flaw for flaw in FLAWS if flaw.name == name)
    known = {"estimation.base_state": "imu", "mock.sensors": sensors, "estimation.disturbance": disturbance}
    config = load(robot).replace({**known, **flaw.changes})
    if known_friction:
        dry = config.settings.mock.joint_friction
        config = config.replace({"robot.friction": {joint: {"dry": dry} for joint in config.settings.robot.joints}})
    trial = EstimationTrial(config, {}, force_sensors=flaw.force_sensors)
    weakened = trial.controller.model.actuators if flaw.gain != 1.0 else ()
    gains = [ActuatorGain(duration=LONGEST, actuator=name, factor=flaw.gain) for name in weakened]
    trial.faults = [*flaw.faults, *gains]
    torques: list[Array] = []
    sway = np.nan
    try:
        trial.stand()
        sway = _error(trial, np.array([[0.0, SWAY, 0.0], [0.0, -SWAY, 0.0], [0.0, 0.0, 0.0]]), torques)
        squat = _error(trial, np.array([[0.0, 0.0, -SQUAT], [0.0, 0.0, 0.0]]), torques)
    except WbcError as error:
        return FlawErrors(sway, np.nan, np.nan, str(error))
    limits = trial.controller.model.effort_limits
    return FlawErrors(sway, squat, chatter(np.array(torques), trial.settings.control.rate, limits))


def _error(trial: EstimationTrial, points: Array, torques: list[Array]) -> float:
    errors = [0.0]
    times = _BEAT * np.arange(1, len(points) + 1)
    trial.follow(times.tolist(), list(trial.origin + points))

    def observe() -> None:
        errors.append(float(np.linalg.norm(trial.com() + trial.shift - trial.reference_com())))
        torques.append(trial.report.command.tau if trial.report.command is not None else torques[-1])

    trial.run(float(times[-1]) + 0.5, observe)
    return max(errors)


def chatter(torques: Array, rate: float, limits: Array, above: float = CHATTER) -> float:
    """Return the largest RMS of torques, (n, na), above a frequency, as a share of the limits, (na,); `rate` in Hz."""
    spectrum = np.fft.rfft(torques * np.hanning(len(torques))[:, None], axis=0)
    frequency = np.fft.rfftfreq(len(torques), 1.0 / rate)
    # Parseval's theorem; 3/8 is the mean square of the window.
    power = 2.0 * np.sum(np.abs(spectrum[frequency > above]) ** 2, axis=0) / len(torques) ** 2 / 0.375
    return float(np.max(np.sqrt(power) / limits))
