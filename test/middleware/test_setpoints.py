"""Setpoint templates have the bytes of the codec."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.middleware.codec import encode
from wbc_controller.middleware.setpoints import JOINT_FIELDS, SetpointTemplate, setpoint_message
from wbc_controller.middleware.topics import TASK_TYPES

SIZES = {"geometry_msgs/msg/PoseStamped": (4, 7), "geometry_msgs/msg/WrenchStamped": (6, 3)}
JOINTS = ("hip", "knee", "left_ankle")
CASES = [
    (kind, types["setpoint"], size)
    for kind, types in TASK_TYPES.items()
    for size in ((3,) if kind in JOINT_FIELDS else SIZES.get(types["setpoint"], (3, 1)))
]


@pytest.mark.parametrize(("kind", "type_name", "size"), CASES)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), stamp=st.integers(0, 2**31 * 10**9 - 1))
def test_in_place_they_have_the_bytes_of_the_codec(kind, type_name, size, seed, stamp):
    rng = np.random.default_rng(seed)
    words = {"frame": "pelvis", "joints": JOINTS if kind in JOINT_FIELDS else ()}
    template = SetpointTemplate(type_name, kind, np.zeros(size), **words)
    for position in rng.normal(size=(3, size)):
        expected = encode(setpoint_message(type_name, kind, position, stamp=stamp, **words))
        assert template.write(stamp, position) == expected
