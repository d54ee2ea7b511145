"""Settings of `safety` without faults by states."""

import math

UNCHECKED = {
    **dict.fromkeys(
        ("max_magnitude", "max_joint_speed", "max_base_speed", "max_base_turn", "joint_mismatch", "base_mismatch",
         "base_turn_mismatch", "frozen_motion", "frozen_time"),
        math.inf,
    ),
    "max_tilt": 3.2,
    "min_height": 0.0,
}  # fmt: skip
