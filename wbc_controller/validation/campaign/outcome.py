"""Outcome of a trial, and names of violations."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from wbc_controller.validation.campaign.monitor import STALL

MAX_FALLEN_TIME = 0.2  # with an active controller, s
#: Violations by decreasing severity.
VIOLATIONS: Mapping[str, str] = {
    "not_finite": "a torque of NaN or infinity",
    "unreadable": "an unreadable torque message, or one of another size",
    "over_limit": "a torque above its effort limit",
    "over_rate": "a torque rate above limits.torque_rate",
    "stale": "torques or damping from a state with a true age above safety.state_timeout",
    "internal_error": "the fault INTERNAL_ERROR",
    "logged": "an exception in the log",
    "stall": f"processor time of the loop above {1e3 * STALL:.0f} ms in one cycle",
    "fell": f"the robot lay on the ground for {MAX_FALLEN_TIME:g} s with an active controller",
    "undetected": "a fault with a deadline was not detected in time",
    "wrong_reason": "damping for an invalid reason, or despite a harmless fault",
    "recording": "the recording of the fault does not name it, or its replay differs",
    "early": "the controller left its active mode before the fault",
    "start": "the robot did not stand at the beginning of the fault",
    "diverged": "the physics of the mock robot diverged; the trial is invalid",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome."""

    robot: str
    kind: str
    seed: int
    parameters: Mapping[str, Any]
    expected: str  # `survive`, `detect` or `either`
    deadline: float | None  # time limit of the detection, s; or None
    result: str  # `survived`, `damped` or `violation`
    code: str  # fault code, or mode without a fault; empty if active
    sentence: str
    after: float | None  # from the beginning of the fault to the end of the active mode, s; or None
    moved: float  # largest displacement of the centre of mass, m
    longest: float  # longest processor time of a cycle, s
    simulated: float  # s
    wall: float  # s
    violations: Mapping[str, str]  # texts by name, as in `VIOLATIONS`
    walking: bool = False  # True if the robot walked
