"""Messages to bytes and back."""

import numpy as np
import pytest
from refusals import input_refusal

from wbc_controller.middleware.codec import decode, encode, header, message, nanoseconds, time_fields

JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state():
    q, v, tau = (np.array(values) for values in ([1.0, -2.0, np.nan], [0.25, 0.5, np.inf], []))
    top, names = header(1_500_000_001, "base"), ["hip", "knee", "ünïcode"]
    return message(JOINT_STATE, header=top, name=names, position=q, velocity=v, effort=tau)


def test_round_trip_and_bytes():
    sent = joint_state()
    received = decode(encode(sent), JOINT_STATE)
    assert received.name == sent.name
    assert received.header == sent.header
    for field in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(received, field), getattr(sent, field))
    assert encode(received) == encode(sent)
    assert encode(message("std_msgs/msg/String", data="ab")) == b"\x00\x01\x00\x00\x03\x00\x00\x00ab\x00"
    assert decode(b"\x00\x00\x00\x00\x3f\xf0" + bytes(6), "std_msgs/msg/Float64").data == 1.0
    # Padding of the middleware is no fault.
    assert decode(encode(message("std_msgs/msg/Bool", data=True)) + b"\0\0\0", "std_msgs/msg/Bool").data


def test_truncated_and_other_bytes_are_refused():
    payload = encode(joint_state())
    for length in range(len(payload)):
        sentence = input_refusal(decode, payload[:length], JOINT_STATE)
        assert sentence.startswith(f"{length} bytes are not a sensor_msgs/msg/JointState")
    odometry, text = "nav_msgs/msg/Odometry", message("std_msgs/msg/String", data="a string")
    assert odometry in input_refusal(decode, encode(text), odometry)
    input_refusal(decode, b"\x00\x01\x00\x00\xff\xff\xff\xff", "std_msgs/msg/String")  # an impossible length


def test_fields_of_a_message():
    time = message("builtin_interfaces/msg/Time", **time_fields(1_763_705_622_123_456_789))
    assert nanoseconds(time) == 1_763_705_622_123_456_789
    pose = message("geometry_msgs/msg/PoseStamped", pose={"position": np.array([1.0, 2.0])})
    (x, y, z), turn = (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z), pose.pose.orientation
    assert (x, y, z, turn.x, turn.y, turn.z, turn.w) == (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert (pose.header.stamp.sec, pose.header.frame_id) == (0, "")
    states = decode(encode(message(JOINT_STATE, name=["a"], effort=np.array([3.0]))), JOINT_STATE)
    assert (states.name, states.position.size, states.effort.tolist()) == (["a"], 0, [3.0])
    assert message("nav_msgs/msg/Odometry").pose.covariance.shape == (36,)
    with pytest.raises(TypeError, match="speed"):
        message(JOINT_STATE, speed=1.0)
