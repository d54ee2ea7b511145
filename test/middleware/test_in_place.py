"""Messages read and written in place give the values and the bytes of the codec."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode, header, message, torques
from wbc_controller.middleware.decoding import read_imu, read_odometry, stamp_of
from wbc_controller.middleware.in_place import FixedShape, Template
from wbc_controller.middleware.joint_order import JointOrder
from wbc_controller.middleware.setpoints import wrench_stamped
from wbc_controller.middleware.states import ImuReader, JointStateReader, OdometryReader

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINTS = ("hip", "knee", "ankle")
#: Any float, its bits as they are: NaN with a payload, -0.0 and denormals too.
FLOATS = st.floats(width=64)
TIMES = st.integers(1, 2**31 * 10**9 - 1)


def joint_state(names, position, velocity, effort=(), time=1, frame=""):
    arrays = (np.array(values, dtype=np.float64) for values in (position, velocity, effort))
    fields = dict(zip(("position", "velocity", "effort"), arrays, strict=True))
    return message(JOINT_STATE, header=header(time, frame), name=list(names), **fields)


def by_codec(payload):
    content = decode(payload, JOINT_STATE)
    q, v = JointOrder(JOINTS).read(content)
    return stamp_of(content), q, v


def odometry_by_codec(payload):
    content = decode(payload, "nav_msgs/msg/Odometry")
    q, v = read_odometry(content, "pelvis")
    return stamp_of(content), q, v


def outcome(read, payload):
    """Stamp, and the bits of positions and velocities; or the refusal."""
    try:
        stamp, q, v = read(payload)
    except InputRefused as refusal:
        return str(refusal)
    return stamp, q.tobytes(), v.tobytes()


@st.composite
def joint_states(draw):
    """Messages whose names, sizes, frames and values now and then change."""
    names = draw(st.sampled_from([JOINTS, JOINTS[::-1], (*JOINTS, "other"), ("hip", "knee"), ("a", "knee", "ankle")]))
    size = st.lists(st.floats(-9, 9) if draw(st.integers(0, 4)) else FLOATS, min_size=len(names), max_size=len(names))
    effort = draw(st.sampled_from([(), np.zeros(len(names))]))
    content = joint_state(names, draw(size), draw(size), effort, draw(TIMES), draw(st.sampled_from(["", "base"])))
    payload = bytearray(encode(content))
    if draw(st.integers(0, 5)) == 0:
        payload[draw(st.integers(0, len(payload) - 1))] ^= draw(st.integers(1, 255))
    return bytes(payload)


@settings(max_examples=300)
@given(st.lists(joint_states(), min_size=1, max_size=5), st.lists(st.integers(0, 4), min_size=3, max_size=12))
def test_joint_states_are_read_as_by_the_codec(made, order):
    reader = JointStateReader(JOINTS)
    for payload in (made[i % len(made)] for i in order):
        assert outcome(reader.read, payload) == outcome(by_codec, payload)


@settings(max_examples=200)
@given(st.lists(st.lists(st.floats(-2, 2), min_size=85, max_size=85), min_size=3, max_size=4), TIMES, st.booleans())
def test_odometry_is_read_as_by_the_codec(make, rows, time, valid):
    reader = OdometryReader("pelvis")
    for values in rows:
        if valid:
            values[3:7] = [0.6, 0.0, values[0] * 0.0, 0.8]
        content = make.odom(values[:7], values[7:13], "pelvis")
        content.header.stamp.sec, content.header.stamp.nanosec = divmod(time, 10**9)
        content.pose.covariance[:] = values[13:49]
        content.twist.covariance[:] = values[49:]
        payload = encode(content)
        assert outcome(reader.read, payload) == outcome(odometry_by_codec, payload)


def imu(values, time=1):
    def vector(x, y, z):
        return message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    seconds, rest = divmod(time, 10**9)
    content = message(
        "sensor_msgs/msg/Imu",
        header=header(0, "pelvis"),
        orientation=message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(*values[:3]),
        angular_velocity_covariance=np.array(values[6:15]),
        linear_acceleration=vector(*values[3:6]),
        linear_acceleration_covariance=np.array(values[15:24]),
    )
    content.header.stamp.sec, content.header.stamp.nanosec = seconds, rest
    return encode(content)


def imu_by_codec(payload):
    content = decode(payload, "sensor_msgs/msg/Imu")
    values = read_imu(content, "pelvis")
    return stamp_of(content), *values


@pytest.mark.parametrize("what", ["angular_velocity", "linear_acceleration"])
def test_an_imu_that_says_that_it_does_not_measure_is_refused(what):
    content = decode(imu([0.0] * 24), "sensor_msgs/msg/Imu")
    setattr(content, f"{what}_covariance", np.array([-1.0, *np.zeros(8)]))
    with pytest.raises(InputRefused, match=f"{what}_covariance begins with -1: the IMU does not measure it"):
        read_imu(content, "pelvis")
    with pytest.raises(InputRefused, match=f"{what}_covariance begins with -1: the IMU does not measure it"):
        ImuReader("pelvis").read(encode(content))


@settings(max_examples=200)
@given(
    st.lists(
        st.lists(
            st.one_of(st.floats(-90, 90), st.sampled_from([-1.0, 0.0, 101.0, 2000.0, np.nan, np.inf])),
            min_size=24,
            max_size=24,
        ),
        min_size=3,
        max_size=6,
    ),
    TIMES,
)
def test_imu_data_are_read_as_by_the_codec(rows, time):
    reader = ImuReader("pelvis")
    for _ in range(3):
        reader.read(imu([0.0] * 24))
    for values in rows:
        payload = imu(values, time)
        assert outcome(reader.read, payload) == outcome(imu_by_codec, payload)


def test_from_the_third_message_of_a_shape_on_the_codec_is_not_asked(make, monkeypatch):
    joints, odometry = JointStateReader(JOINTS), OdometryReader("pelvis")
    asked = []
    monkeypatch.setattr("wbc_controller.middleware.states.decode", lambda *what: asked.append(what) or decode(*what))
    for time in range(1, 6):
        joints.read(encode(joint_state(JOINTS, [time] * 3, [0] * 3, time=time)))
        stamp, q, _ = joints.read(encode(joint_state(JOINTS, [time] * 3, [0] * 3, time=time)))
        assert (stamp, q[0]) == (time, time)
        odometry.read(encode(make.odom([time, 0, 0, 0, 0, 0, 1], child="pelvis")))
    assert len(asked) == 4
    joints.read(encode(joint_state(JOINTS[::-1], [0] * 3, [0] * 3)))  # the same size, and another shape
    assert len(asked) == 5


def test_values_that_were_read_are_not_those_of_the_message():
    reader, payload = JointStateReader(JOINTS), encode(joint_state(JOINTS, [1, 2, 3], [4, 5, 6]))
    for _ in range(3):
        _, q, v = reader.read(payload)
    q[:] = v[:] = 0.0
    assert reader.read(payload)[1].tolist() == [1, 2, 3]


def test_a_writer_that_leaves_other_bytes_between_the_fields_is_read_by_the_codec():
    payload = bytearray(encode(joint_state(JOINTS, [1, 2, 3], [4, 5, 6])))
    place = payload.index(b"hip\0") + 4
    assert encode(joint_state(("hi", *JOINTS[1:]), [0] * 3, [0] * 3))[place - 1] == 0
    payload = bytearray(encode(joint_state(("hip", "knees", "ankle"), [1, 2, 3], [4, 5, 6])))
    padding = payload.index(b"knees\0") + 6
    payload[padding] = 7
    reader = JointStateReader(("hip", "knees", "ankle"))
    for _ in range(4):
        assert reader.read(bytes(payload))[1].tolist() == [1, 2, 3]
    assert reader._shape is None


@settings(max_examples=100)
@given(TIMES, st.lists(FLOATS, min_size=6, max_size=6))
def test_templates_write_the_bytes_of_the_codec(time, values):
    row = np.array(values)
    effort = Template(torques(np.zeros(6)), ["data"])
    assert effort.write(time, row) == encode(torques(row))
    joints = Template(joint_state("abcdef", [0] * 6, [0] * 6, [0] * 6), ["position"], ["velocity"], ["effort"])
    expected = encode(joint_state("abcdef", row, row[::-1], -row, time))
    assert joints.write(time, row, row[::-1], -row) == expected
    axes = [f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
    wrench = Template(wrench_stamped(np.zeros(6), "foot"), axes)
    assert wrench.write(time, row) == encode(wrench_stamped(row, "foot", time))


def test_a_product_is_written_as_the_numbers_that_it_is():
    axes = [f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
    wrench, rng = Template(wrench_stamped(np.zeros(6), "foot"), axes), np.random.default_rng(5)
    for k in (1, 3, 6):
        basis, force = rng.integers(-9, 9, size=(6, k)).astype(float), rng.integers(-9, 9, size=k).astype(float)
        assert wrench.write_product(7, basis, force) == encode(wrench_stamped(basis @ force + 0.0, "foot", 7))


def test_numbers_of_another_size_are_not_written():
    wrench = Template(wrench_stamped(np.zeros(6), "foot"), [f"wrench.force.{axis}" for axis in "xyz"])
    for size in (0, 2, 4):
        with pytest.raises(ValueError, match=f"{size}, 0 and 0 numbers for the fields"):
            wrench.write(1, np.ones(size))
    with pytest.raises(ValueError, match="3, 1 and 0 numbers"):
        wrench.write(1, np.ones(3), np.ones(1))
    for shape, size in (((4, 2), 2), ((3, 2), 3)):
        with pytest.raises(ValueError, match="a matrix"):
            wrench.write_product(1, np.ones(shape), np.ones(size))


def test_empty_arrays_have_no_place_and_strings_no_numbers():
    shape = FixedShape(joint_state(JOINTS, [1, 2, 3], [1, 2, 3]))
    with pytest.raises(KeyError):
        shape.place("effort")
    assert FixedShape(message("std_msgs/msg/String", data="text")).fits(
        encode(message("std_msgs/msg/String", data="text"))
    )
