"""Templates write the bytes of the codec, and layouts find the numbers of a message."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.middleware import codec
from wbc_controller.middleware.codec import MessageLayout, Template, encode, message, wrench_stamped


@settings(max_examples=100)
@given(st.integers(1, 2**31 * 10**9 - 1), st.lists(st.floats(width=64), min_size=6, max_size=6))
def test_templates_write_the_bytes_of_the_codec(make, time, values):
    row = np.array(values)
    assert Template(codec.torques(np.zeros(6)), ["data"]).write(time, row) == encode(codec.torques(row))
    joints = Template(make.joint_state("abcdef", [0] * 6, [0] * 6, [0] * 6), ["position"], ["velocity"], ["effort"])
    assert joints.write(time, row, row[::-1], -row) == encode(make.joint_state("abcdef", row, row[::-1], -row, time))
    wrench = Template(wrench_stamped(np.zeros(6), "foot"), codec.WRENCH)
    assert wrench.write(time, row) == encode(wrench_stamped(row, "foot", time))


def test_numbers_of_another_size_are_not_written():
    wrench = Template(wrench_stamped(np.zeros(6), "foot"), codec.WRENCH[:3])
    for size in (0, 1, 2, 4):
        with pytest.raises(ValueError, match=f"{size} numbers for a field of 3"):
            wrench.write(1, np.ones(size))
    for values in ((), (np.ones(3), np.ones(1))):
        with pytest.raises(ValueError, match=r"zip\(\) argument 2 is"):
            wrench.write(1, *values)


def test_fields_of_a_group_follow_one_another(make):
    content = make.joint_state(["hip", "knee"], [1, 2], [3, 4], [])
    layout, payload = MessageLayout(content), encode(content)
    numbers = np.frombuffer(payload, np.float64, layout.count, codec.START)
    assert numbers[layout.index_of("velocity", "position")].tolist() == [3, 4, 1, 2]
    with pytest.raises(KeyError):
        layout.index_of("effort")  # empty
    with pytest.raises(ValueError, match="must be consecutive"):
        Template(content, ["position", "velocity"])  # the size of the second array is between them


def test_a_layout_fits_messages_with_other_numbers_only(make):
    layout = MessageLayout(make.joint_state(["hip", "knee"], [1, 2], [3, 4], []))
    assert layout.fits(encode(make.joint_state(["hip", "knee"], [5, 6], [7, 8], [], time=9)))
    assert not layout.fits(encode(make.joint_state(["hip", "kneE"], [1, 2], [3, 4], [])))
    assert not layout.fits(encode(make.joint_state(["hip", "knee"], [1, 2], [3, 4], [5, 6])))
    text = message("std_msgs/msg/String", data="text")
    assert MessageLayout(text).fits(encode(text))
