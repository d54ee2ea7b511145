"""The outcome of a trial, and the names of all violations."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from wbc_controller.validation.campaign.monitor import VIOLATIONS

#: Longest time for which a robot may be fallen while its controller is active, s.
UNSEEN = 0.2
#: Every name of a violation, with its meaning: what the monitor finds, and what the outcome tells.
ALL_VIOLATIONS: Mapping[str, str] = {
    **VIOLATIONS,
    "start": "the robot did not stand when the fault was to begin",
    "early": "the controller left its active mode before the fault began",
    "undetected": "a fault that must be detected was not, or too late",
    "wrong_reason": "damping for a reason that this kind of fault does not have, or with one that is harmless",
    "fell": f"the robot lay on the ground for {UNSEEN:g} s while its controller was active",
    "recording": "the fault's recording does not name it, or does not come out bit for bit when it is solved again",
    "diverged": "the physics of the mock robot diverged: the trial says nothing",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of one trial."""

    robot: str
    kind: str
    seed: int
    parameters: Mapping[str, Any]
    expected: str  # `survive`, `detect` or `either`
    deadline: float | None  # time after the beginning of the fault within which it had to be detected, s; None for none
    result: str  # `survived`, `damped` or `violation`
    code: str  # code of the controller's fault, or its mode if it had none; empty if it stayed active
    sentence: str
    after: float | None  # time from the beginning of the fault until then, s; None if it stayed active
    moved: float  # largest distance of the centre of mass from its place at the beginning of the fault, m
    longest: float  # longest processor time of the loop for one cycle, s
    simulated: float  # length of the trial, s
    wall: float  # wall time that it took, s
    violations: Mapping[str, str]  # sentences by name, as in `ALL_VIOLATIONS`
