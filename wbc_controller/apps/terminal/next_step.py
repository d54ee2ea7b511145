"""What a user does after a fault, by its code."""

from __future__ import annotations

import re
from collections.abc import Mapping

#: What to look for and to do, by the code of the fault.
NEXT_STEPS: Mapping[str, str] = {
    "CLOCK": "see that one node publishes the time, and that nobody sets the clock; then reset, activate",
    "STALE_INPUT": "see that the robot's driver runs, and its messages come in time (wbc status); then reset, activate",
    "ESTIMATE_LOST": "look at the IMU and its mounting; let the robot stand still or hang it up; then reset, activate",
    "IMPLAUSIBLE_STATE": "look at the joint or sensor that is named, with the robot hung up; then reset, activate",
    "FALLEN": "hold the robot up (wbc send hold for the mock robot), then reset, activate, release",
    "NO_SOLUTION": "wbc replay names the constraints in conflict; take back the last request; then reset, activate",
    "RELAXED": "look at the constraints that were relaxed; ask for less; then reset, activate",
    "BAD_TORQUE": "look at the recording of the fault (wbc replay); then reset, activate",
    "ESTOP": "when it is safe: reset, then activate",
    "METHOD_FAILED": "correct the class and method that are named; the log has the traceback; then start it again",
    "INTERNAL_ERROR": "a defect of the controller: keep the log and the recording of the fault, and report it",
}
_CODE = re.compile(rf"\b({'|'.join(NEXT_STEPS)})\b")


def next_step(said: str) -> str:
    """What to do next, by the code in what the controller says of its mode; empty where it names no fault."""
    found = _CODE.search(said)
    return NEXT_STEPS[found[1]] if found else ""
