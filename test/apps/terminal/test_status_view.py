"""Facts of the status, from the values on /diagnostics."""

import numpy as np

from wbc_controller.apps.terminal.status_view import RobotStatus, facts
from wbc_controller.middleware.codec import diagnostics


def test_facts_of_a_conflict_with_two_publishers():
    values = {
        "audit/energy_residual": "1.5 W", "publishers//joint_states": "/gui, /mock_robot",
        "infeasibility/conflict": "torque:knee, cone:foot", "infeasibility/slack/torque:knee": "12.35 N·m",
    }  # fmt: skip
    (status,) = diagnostics(1, 2, "wbc_controller: control loop", "damping", "go2", values).status
    found = facts(RobotStatus(status, np.nan, {}, ""))
    assert found["audit"] == "energy_residual 1.5 W"
    assert found["infeasibility"] == "conflict torque:knee, cone:foot; slack/torque:knee 12.35 N·m"
    assert found["publishers"] == "/joint_states /gui, /mock_robot"
    assert (found["cycles"], found["guard"]) == ("counting", "no messages")
