"""Decoders of measured states: equal to the codec, and refusals of invalid messages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import input_refusal

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode, header, message, wrench_stamped
from wbc_controller.middleware.states import ContactForceReader, ImuReader, JointStateReader, OdometryReader
from wbc_controller.simulation.sensors import imu_message

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINTS = ("hip", "knee", "ankle")
#: Any float with its bits: NaN with a payload, -0.0 and denormals too.
FLOATS = st.floats(width=64)
TIMES = st.integers(1, 2**31 * 10**9 - 1)
NAN, INF = float("nan"), float("inf")


def joint_state(names, position, velocity, effort=(), time=1, frame=""):
    arrays = (np.array(values, dtype=np.float64) for values in (position, velocity, effort))
    fields = dict(zip(("position", "velocity", "effort"), arrays, strict=True))
    return message(JOINT_STATE, header=header(time, frame), name=list(names), **fields)


def time_by_codec(content):
    stamp = content.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec if stamp.sec >= 0 and stamp.nanosec < 10**9 else None


def joints_by_codec(payload):
    """Return stamp and bytes of the arrays, or None for an invalid message."""
    try:
        content = decode(payload, JOINT_STATE)
    except InputRefused:
        return None
    names, time = content.name, time_by_codec(content)
    arrays = (content.position, content.velocity)
    if len(set(names)) < len(names) or not set(JOINTS) <= set(names) or any(len(a) != len(names) for a in arrays):
        return None
    own = [np.array([array[names.index(joint)] for joint in JOINTS]) for array in arrays]
    return None if time is None or not np.isfinite(own).all() else (time, own[0].tobytes(), own[1].tobytes())


def outcome(reader, payload):
    """Return stamp and bytes of the first two arrays, or None for a refused message."""
    try:
        read = reader.read(payload)
    except InputRefused:
        return None
    return read[0], read[1].tobytes(), read[2].tobytes()


@st.composite
def joint_states(draw):
    """Messages with occasional changes of names, sizes, frames and values."""
    names = draw(st.sampled_from([JOINTS, JOINTS[::-1], (*JOINTS, "other"), ("hip", "knee"), ("a", "knee", "ankle")]))
    size = st.lists(st.floats(-9, 9) if draw(st.integers(0, 4)) else FLOATS, min_size=len(names), max_size=len(names))
    effort = draw(st.sampled_from([(), np.zeros(len(names))]))
    content = joint_state(names, draw(size), draw(size), effort, draw(TIMES), draw(st.sampled_from(["", "base"])))
    payload = bytearray(encode(content))
    if draw(st.integers(0, 5)) == 0:
        payload[draw(st.integers(0, len(payload) - 1))] ^= draw(st.integers(1, 255))
    return bytes(payload)


@settings(max_examples=100)
@given(st.lists(joint_states(), min_size=1, max_size=5), st.lists(st.integers(0, 4), min_size=3, max_size=12))
def test_joint_states_have_the_numbers_of_the_codec(made, order):
    reader = JointStateReader(JOINTS)
    for payload in (made[i % len(made)] for i in order):
        assert outcome(reader, payload) == joints_by_codec(payload)


@settings(max_examples=30)
@given(st.lists(st.lists(st.floats(-2, 2), min_size=85, max_size=85), min_size=2, max_size=4), TIMES)
def test_odometry_has_the_numbers_of_the_codec(make, rows, time):
    reader = OdometryReader("pelvis")
    for values in rows:
        values[3:7] = [0.6, 0.0, 0.0, 0.8]
        content = make.odom(values[:7], values[7:13], "pelvis", time)
        content.pose.covariance[:] = values[13:49]
        content.twist.covariance[:] = values[49:]
        read = reader.read(encode(content))
        assert read.stamp == time
        np.testing.assert_allclose(read.pose, values[:7], rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(read.twist, values[7:13])


#: Numbers of an IMU, some out of range.
MEASURED = st.one_of(st.floats(-90, 90), st.sampled_from([-1.0, 0.0, 101.0, 2000.0, NAN, INF]))


def imu(values, time=1, frame="pelvis"):
    content = imu_message(time, frame, np.zeros(4), np.array(values[:3]), np.array(values[3:6]))
    content.angular_velocity_covariance = np.array(values[6:15])
    content.linear_acceleration_covariance = np.array(values[15:24])
    return encode(content)


@settings(max_examples=60)
@given(st.lists(st.lists(MEASURED, min_size=24, max_size=24), min_size=1, max_size=6), TIMES)
def test_imu_data_have_the_numbers_of_the_codec(rows, time):
    reader = ImuReader("pelvis")
    for values in rows:
        rates, forces = np.array(values[:3]), np.array(values[3:6])
        good = values[6] != -1.0 and values[15] != -1.0
        good = good and (np.abs(rates) <= 100.0).all() and (np.abs(forces) <= 1000.0).all()
        expected = (time, rates.tobytes(), forces.tobytes()) if good else None
        assert outcome(reader, imu(values, time)) == expected


def test_data_without_measurement_are_refused():
    for what in ("angular_velocity", "linear_acceleration"):
        content = decode(imu([0.0] * 24), "sensor_msgs/msg/Imu")
        setattr(content, f"{what}_covariance", np.array([-1.0, *np.zeros(8)]))
        said = f"{what}_covariance begins with -1: the IMU does not measure {what}"
        assert said in input_refusal(ImuReader("pelvis").read, encode(content))


def test_the_normal_force_follows_the_frame_of_each_message():
    reader = ContactForceReader("foot", {"foot_link": np.array([0, 0, 1.0]), "world": np.array([0, 1.0, 0])})
    for frame, normal in (("foot_link", 3.0), ("world", 2.0), ("foot_link", 3.0), ("world", 2.0)):
        assert reader.read(encode(wrench_stamped(np.arange(1.0, 7.0), frame, 7))) == (7, normal)


def test_arrays_own_their_data_and_padding_is_ignored():
    reader, payload = JointStateReader(JOINTS), encode(joint_state(JOINTS, [1, 2, 3], [4, 5, 6]))
    for _ in range(2):
        read = reader.read(payload)
        read.position[:] = read.velocity[:] = 0.0
    assert reader.read(payload).position.tolist() == [1, 2, 3]
    joints = ("hip", "knees", "ankle")
    payload = bytearray(encode(joint_state(joints, [1, 2, 3], [4, 5, 6])))
    payload[payload.index(b"knees\0") + 6] = 7
    reader = JointStateReader(joints)
    for _ in range(3):
        assert reader.read(bytes(payload)).position.tolist() == [1, 2, 3]
        assert reader.read(encode(joint_state(joints, [3, 2, 1], [4, 5, 6]))).position.tolist() == [3, 2, 1]


class TestJointStates:
    def read(self, content, reader=None):
        return (reader or JointStateReader(JOINTS)).read(encode(content))

    def assert_refused(self, content, said, reader=None):
        assert said in input_refusal(self.read, content, reader)

    def test_values_are_matched_by_name_and_others_are_ignored(self, make):
        _, q, v, _ = self.read(make.joint_state(["ankle", "x", "hip", "knee"], [3, NAN, 1, 2], [30, NAN, 10, 20]))
        np.testing.assert_array_equal(q, [1, 2, 3])
        np.testing.assert_array_equal(v, [10, 20, 30])

    @pytest.mark.parametrize("columns", [("position",), ("effort",), ("velocity", "effort")])
    def test_columns_that_are_not_read_may_be_missing(self, columns):
        arrays = {column: np.array([2.0, 1.0]) for column in columns}
        others = dict.fromkeys({"position", "velocity", "effort"} - set(columns), np.zeros(0))
        content = message(JOINT_STATE, header=header(1), name=["knee", "hip"], **arrays, **others)
        read = self.read(content, JointStateReader(("hip", "knee"), *columns))
        assert [getattr(read, column).tolist() for column in columns] == [[1.0, 2.0]] * len(columns)
        assert all(len(getattr(read, column)) == 0 for column in others)

    def test_the_refused_value_is_named(self, make):
        for bad in (NAN, INF, -INF):
            for what, unit in (("position", "rad"), ("velocity", "rad/s")):
                arrays = {"position": [0.0] * 3, "velocity": [0.0] * 3} | {what: [0.0, bad, 0.0]}
                said = f"{what} of 'knee' is {bad} {unit}; every value must be finite"
                self.assert_refused(make.joint_state(JOINTS, **arrays), said)
        setting = "for a robot without velocity sensors set estimation.joint_velocity to differentiated"
        for names, position, velocity, said in (
            (
                ["hip", "nee", "ancle"],
                [0] * 3,
                [0] * 3,
                "2 of 3 joints are missing: knee, ankle; unknown joints: nee, ",
            ),
            (["hip", "knee"], [0] * 2, [0] * 2, "1 of 3 joints are missing: ankle"),
            ([], [], [], "3 of 3 joints are missing: hip, knee, ankle"),
            ([*JOINTS, "knee"], [0] * 4, [0] * 4, "duplicate joint 'knee'"),
            (JOINTS, [0, 0], [0] * 3, "position has 2 values for 3 names"),
            (JOINTS, [0] * 4, [0] * 3, "position has 4 values for 3 names"),
            (JOINTS, [], [0] * 3, "position has 0 values for 3 names"),
            (JOINTS, [0] * 3, [NAN] * 3, f"velocity of 'hip' is nan rad/s; every value must be finite; {setting}"),
            (JOINTS, [0] * 3, [], f"velocity has 0 values for 3 names; {setting}"),
        ):
            self.assert_refused(make.joint_state(names, position, velocity), said)
        for seconds, nanoseconds in ((-1, 0), (0, 10**9)):
            content = make.joint_state(JOINTS, [0] * 3, [0] * 3)
            content.header.stamp.sec, content.header.stamp.nanosec = seconds, nanoseconds
            said = f"header.stamp has sec = {seconds}, nanosec = {nanoseconds}; valid: sec from 0"
            self.assert_refused(content, said)

    def test_joints_that_are_split_over_several_messages_are_found(self, make):
        reader, missing = JointStateReader(JOINTS), "2 of 3 joints are missing: knee, ankle; unknown joints: finger"
        self.assert_refused(make.joint_state(["hip", "finger"], [0] * 2, [0] * 2), missing, reader)
        sentence = (
            "1 of 3 joints are missing: hip; the joints are split over several messages: publish them in one, "
            "for example with the source_list of joint_state_publisher"
        )
        self.assert_refused(make.joint_state(["knee", "ankle"], [0] * 2, [0] * 2), sentence, reader)


class TestOdometry:
    def read(self, content):
        return OdometryReader("pelvis").read(encode(content))

    def test_a_quaternion_that_is_nearly_one_is_made_one(self, make):
        np.testing.assert_array_equal(self.read(make.odom([0, 0, 0, 0, 0, 0, 1.009])).pose[3:], [0, 0, 0, 1])

    def test_invalid_values_are_refused(self, make):
        said = input_refusal(self.read, make.odom([0, 0, 0, 0, 0, 0, 1], child="torso"))
        assert "child_frame_id is 'torso'; the robot's base link is 'pelvis'" in said
        for quaternion, norm in (((0, 0, 0, 0), "0"), ((0, 0, 0, 2), "2"), ((1, 1, 0, 0), "1.41")):
            said = input_refusal(self.read, make.odom([0, 0, 0, *quaternion]))
            assert f"is not a unit quaternion (norm {norm})" in said
        for place in range(13):
            for bad in (NAN, INF):
                values = np.eye(13)[6]
                values[place] = bad
                with pytest.raises(InputRefused, match=rf"the (pose|twist) is not finite: .*{bad}"):
                    self.read(make.odom(values[:7], values[7:]))
