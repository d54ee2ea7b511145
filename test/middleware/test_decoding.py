"""Decoding of messages, and all refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import input_refusal

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references import changes as requests
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.middleware.decoding import READERS, Vocabulary
from wbc_controller.validation.fuzz.strategies import hostile_text

JOINTS = ("hip", "knee", "ankle")
WORDS = Vocabulary(
    kinds={
        "com": "com",
        "hand": "frame_pose",
        "elbow": "frame_position",
        "torso": "frame_orientation",
        "posture": "posture",
        "wrist": "relative_pose",
        "thumb": "axis_alignment",
        "visor": "gaze",
        "sway": "linear_momentum",
        "spin": "angular_momentum",
        "steady": "capture_point",
    },
    joints={"posture": JOINTS},
    contacts=("left_foot", "right_foot"),
    robot_frames=("pelvis", "torso_link"),
    reference_frames={"wrist": "right_hand"},
)
HALF = np.sqrt(0.5)
NAN, INF = float("nan"), float("inf")
AT = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def read(key, subject, content):
    """Encode and decode, as over a transport."""
    return READERS[key](WORDS, subject, decode(encode(content), content.__msgtype__))


def one(key, subject, content):
    (change,) = read(key, subject, content)
    return change


def assert_refused(key, subject, *cases):
    """Check pairs of a content and a part of the refusal."""
    for content, said in cases:
        assert said in input_refusal(read, key, subject, content)


class TestSetpoints:
    def test_positions(self, make):
        for task in ("com", "elbow", "visor"):
            change = one("setpoint", task, make.point([1, 2, 3]))
            assert isinstance(change, requests.SetSetpoint)
            assert change.task == task
            np.testing.assert_array_equal(change.position, [1, 2, 3])
        for task in ("sway", "spin"):
            np.testing.assert_array_equal(one("setpoint", task, make.vector([1, 0, -3])).position, [1, 0, -3])
        pose = one("setpoint", "hand", make.pose([1, 2, 3], [0, 0, HALF, HALF]))
        np.testing.assert_allclose(pose.position, [1, 2, 3, 0, 0, HALF, HALF])
        orientation = one("setpoint", "torso", make.pose([NAN, 2, 3], [0, 0, HALF, HALF]))
        np.testing.assert_allclose(orientation.position, [0, 0, HALF, HALF])
        joints = one("setpoint", "posture", make.joint_state(["ankle", "hip", "knee"], [3, 1, 2]))
        np.testing.assert_array_equal(joints.position, [1, 2, 3])

    @pytest.mark.parametrize("frame", ["", "world", "odom", "map"])
    def test_frames_of_the_world(self, make, frame):
        read("setpoint", "com", make.point([1, 2, 3], frame))

    def test_another_frame_is_refused_with_the_valid_ones(self, make):
        world = ": the world (world, odom, map)"
        own = "relative to its reference (hand/reference, hand/heading) or a frame of the robot"
        assert_refused(
            "setpoint", "hand",
            (make.pose([1, 2, 3], frame="palvis"), f"{world} or {own}; did you mean 'pelvis'?"),
            (make.pose([1, 2, 3], frame="com/reference"), "frame_id is 'com/reference'; valid for setpoints"),
        )  # fmt: skip
        sway = make.vector([1, 2, 3], "pelvis"), f"{world} or relative to its reference (sway"
        assert_refused("setpoint", "sway", sway)
        assert_refused("setpoint", "thumb", (make.vector([1, 2, 3], "thumb/reference"), "reference (thumb/heading)"))
        wrench = make.wrench([1] * 6, "pelvis"), "valid for an external wrench: world, odom, map"
        assert_refused("external_wrench", "pelvis", wrench)
        trajectory = make.frame_trajectory([(1.0, [AT])], "hand"), "valid for a trajectory: world, odom, map"
        assert_refused("trajectory", "com", trajectory)

    @pytest.mark.parametrize("frame", ["com/reference", "com/heading", "pelvis"])
    def test_a_setpoint_may_be_given_in_another_frame(self, make, frame):
        for change in (
            one("setpoint", "com", make.point([1, 2, 3], frame)),
            one("update", "", make.string(f"{{tasks: {{com: {{setpoint: [1, 2, 3], frame: {frame}}}}}}}")),
        ):
            assert change.frame == frame
            np.testing.assert_array_equal(change.position, [1, 2, 3])

    def test_of_joints_that_are_displaced_only_some_need_names(self, make):
        content = make.joint_state(["knee"], [0.5])
        content.header.frame_id = "posture/reference"
        change = one("setpoint", "posture", content)
        assert change.frame == "posture/reference"
        np.testing.assert_array_equal(change.position, [0.0, 0.5, 0.0])
        content.header.frame_id = "posture/refrence"
        valid = ": the world (world, odom, map) or relative to its reference (posture/reference)"
        assert_refused("setpoint", "posture", (content, valid))

    def test_of_a_capture_point_only_x_and_y_are_read(self, make):
        for change in (
            one("setpoint", "steady", make.point([1, 2, NAN])),
            one("update", "", make.string("{tasks: {steady: {setpoint: [1, 2]}}}")),
        ):
            np.testing.assert_array_equal(change.position, [1, 2])

    def test_a_direction_has_the_length_one(self, make):
        for change in (
            one("setpoint", "thumb", make.vector([0, 3, 4])),
            one("update", "", make.string("{tasks: {thumb: {setpoint: [0, 3, 4]}}}")),
            *one("trajectory", "thumb", make.frame_trajectory([(1.0, [[0, 3, 4, 0, 0, 0, 1]])])).points,
        ):
            np.testing.assert_allclose(change.position, [0, 0.6, 0.8])
        none = "has no direction"
        assert_refused("setpoint", "thumb", (make.vector([0, 0, 0]), f"the vector [0, 0, 0] {none} (length 0)"))
        content = make.frame_trajectory([(1.0, [[0, 0, 0, 0, 0, 0, 1]])])
        assert_refused("trajectory", "thumb", (content, f"the transform [0, 0, 0] {none}"))
        content = make.string("{tasks: {thumb: {setpoint: [0, 0, 0]}}}")
        assert_refused("update", "", (content, f"tasks.thumb.setpoint [0, 0, 0] {none}"))

    def test_a_relative_pose_is_given_in_its_reference_frame(self, make):
        change = one("setpoint", "wrist", make.pose([1, 2, 3], [0, 0, HALF, HALF], "right_hand"))
        np.testing.assert_allclose(change.position, [1, 2, 3, 0, 0, HALF, HALF])
        one("trajectory", "wrist", make.frame_trajectory([(1.0, [AT])], "right_hand"))
        valid = "of task 'wrist': its reference frame 'right_hand'"
        for frame in ("", "world", "left_hand"):
            said = f"frame_id is {frame!r}; valid for setpoints {valid} or relative to its reference (wrist/reference)"
            assert_refused("setpoint", "wrist", (make.pose([1, 2, 3], frame=frame), said))
            said = f"frame_id is {frame!r}; valid for a trajectory {valid}"
            assert_refused("trajectory", "wrist", (make.frame_trajectory([(1.0, [AT])], frame), said))

    def test_values_that_are_refused(self, make):
        for names, values, said in (
            (["hip", "knee", "ancle"], [0] * 3, "'ancle' is not a joint of this task; did you mean 'ankle'? Valid:"),
            (["hip", "knee"], [0, 0], "position: 1 joints are missing: ankle"),
            (JOINTS, [0, 0], "position has 2 values for 3 names"),
            ([*JOINTS, "hip"], [0] * 4, "duplicate joint 'hip'"),
            (JOINTS, [0, NAN, 0], "position is not finite: [0, nan, 0]"),
        ):
            assert_refused("setpoint", "posture", (make.joint_state(names, values), said))
        assert_refused("setpoint", "com", (make.point([1, NAN, 3]), "the point is not finite: [1, nan, 3]"))
        assert_refused(
            "setpoint", "hand",
            (make.pose([1, 2, 3], [0, 0, 0, 0.9]), "[0, 0, 0, 0.9] is not a unit quaternion (norm 0.9)"),
            (make.pose([1, INF, 3]), "the pose is not finite: [1, inf, 3, 0, 0, 0, 1]"),
        )  # fmt: skip


class TestSwitchesAndWeights:
    def test_commands_and_settings(self, make):
        for weight in (0.0, 2.5, 1e6):
            assert read("weight", "com", make.float64(weight)) == (requests.SetWeight("com", weight),)
        assert read("task_enable", "com", make.bool(False)) == (requests.EnableTask("com", False),)
        assert read("contact_enable", "left_foot", make.bool(True)) == (requests.EnableContact("left_foot", True),)
        change = one("external_wrench", "pelvis", make.wrench([1, 2, 3, 4, 5, 6]))
        assert isinstance(change, requests.SetExternalWrench)
        np.testing.assert_array_equal(change.wrench, [1, 2, 3, 4, 5, 6])

    def test_values_out_of_range(self, make):
        for bad in (NAN, INF, -INF, -1e-9, 1.0001e6):
            assert_refused("weight", "com", (make.float64(bad), f"weight must be from 0 to 1e+06, not {bad!r}"))
        wrench = make.wrench([0, 0, 0, 0, NAN, 0]), "the wrench is not finite: [0, 0, 0, 0, nan, 0]"
        assert_refused("external_wrench", "pelvis", wrench)


class TestWalking:
    @pytest.mark.parametrize("key", ["cmd_vel", "cmd_vel_stamped"])
    def test_a_velocity_to_walk_at(self, make, key):
        change = one(key, "", make.velocity(key, [0.3, -0.1, 0.0, 0.0, 0.0, 0.5]))
        assert change.streamed
        np.testing.assert_array_equal(change.velocity, [0.3, -0.1, 0.5])
        assert read(key, "", make.velocity(key, [0.0] * 6)) == (requests.Walk(None, streamed=True),)

    def test_a_goal_and_footsteps(self, make):
        goal = one("walk_goal", "", make.pose([1.0, -2.0, 0.3], [0.0, 0.0, np.sin(0.6), np.cos(0.6)]))
        np.testing.assert_allclose(goal.pose, [1.0, -2.0, 1.2])
        poses = [[0.1, 0.2, -3.0], [0.3, -0.1, 0.5]]
        np.testing.assert_allclose(one("walk_footsteps", "", make.pose_array(poses)).poses, poses)

    def test_values_that_are_refused(self, make):
        unused = "linear.z, angular.x and angular.y are [0.2, 0.0, 0.0]; they must be 0: walking uses linear.x"
        assert_refused(
            "cmd_vel", "",
            (make.velocity("cmd_vel", [0.3, 0.0, 0.2, 0.0, 0.0, 0.0]), unused),
            (make.velocity("cmd_vel", [NAN, 0.0, 0.0, 0.0, 0.0, 0.0]), "the velocity is not finite"),
        )  # fmt: skip
        upright, far = [0, 0, 0, 1], "the goal is at [20000, 0] m; valid: up to 10000 m from the origin"
        assert_refused(
            "walk_goal", "",
            (make.pose([NAN, 0, 0], upright), "the goal is not finite"),
            (make.pose([2e4, 0, 0], upright), far),
            (make.pose([0, 0, 0], [0, 0, 0, 0]), "is not a unit quaternion"),
            (make.pose([0, 0, 0], [0.6, 0, 0, 0.8]), "the orientation of the goal is tilted (x 0.6, y 0); it must be"),
            (make.pose([0, 0, 0], upright, "pelvis"), "frame_id is 'pelvis'; valid for a goal: world, odom, map"),
        )  # fmt: skip
        assert_refused(
            "walk_footsteps", "",
            (make.pose_array([]), "the message has 0 footsteps; valid: 1 to 1000"),
            (make.pose_array([[0.0, 0.1, 0.0], [NAN, 0.0, 0.0]]), "step 2 is not finite"),
        )  # fmt: skip


class TestTrajectories:
    def test_of_joints(self, make):
        points = [(0.5, [3, 1, 2]), (1.0, [6, 4, 5], [30, 10, 20], [0.3, 0.1, 0.2]), (2.0, [0, 0, 0])]
        change = one(
            "trajectory", "posture", make.joint_trajectory(["ankle", "hip", "knee"], points, start=2_500_000_000)
        )
        assert isinstance(change, requests.SetTrajectory)
        assert change.start == 2.5
        assert [point.time for point in change.points] == [0.5, 1.0, 2.0]
        np.testing.assert_array_equal(change.points[0].position, [1, 2, 3])
        np.testing.assert_array_equal(change.points[0].velocity, [0, 0, 0])
        np.testing.assert_array_equal(change.points[1].velocity, [10, 20, 30])
        np.testing.assert_array_equal(change.points[1].acceleration, [0.1, 0.2, 0.3])

    @pytest.mark.parametrize(("task", "position", "velocity"), [
        ("com", 3, 3), ("hand", 7, 6), ("torso", 4, 3), ("wrist", 7, 6), ("visor", 3, 3), ("spin", 3, 3),
        ("steady", 2, 2),
    ])  # fmt: skip
    def test_of_a_frame(self, make, task, position, velocity):
        points = [(1.0, [[1, 2, 3, 0, 0, HALF, HALF]], [[1, 2, 3, 4, 5, 6]]), (2.0, [AT])]
        change = one("trajectory", task, make.frame_trajectory(points, WORDS.reference_frames.get(task, "world")))
        assert change.start is None
        pose, twist = np.array([1, 2, 3, 0, 0, HALF, HALF]), np.array([1.0, 2, 3, 4, 5, 6])
        np.testing.assert_allclose(change.points[0].position, pose[3:] if task == "torso" else pose[:position])
        np.testing.assert_array_equal(change.points[0].velocity, twist[3:] if task == "torso" else twist[:velocity])

    @pytest.mark.parametrize("times", [(1.0, 1.0), (-0.1, 1.0), (0.0, 2.0, 1.0)])
    def test_times_that_do_not_rise_from_zero(self, make, times):
        shown = ", ".join(f"{time:g}" for time in times)
        said = f"time_from_start must increase from 0, got [{shown}] s"
        for task, content in (
            ("com", make.frame_trajectory([(time, [AT]) for time in times])),
            ("posture", make.joint_trajectory(JOINTS, [(time, [0, 0, 0]) for time in times])),
        ):
            assert_refused("trajectory", task, (content, said))

    def test_values_that_are_refused(self, make):
        for names, point, said in (
            (["hip", "knee"], ([0, 0],), "positions: 1 joints are missing: ankle"),
            (JOINTS, ([],), "positions has 0 values for 3 names"),
            (JOINTS, ([0, 0, 0], [1, 2]), "velocities has 2 values for 3 names"),
            (JOINTS, ([0, 0, 0], [], [1]), "accelerations has 1 values for 3 names"),
            (JOINTS, ([0, 0, INF],), "positions is not finite"),
            (JOINTS, ([0, 0, 0], [NAN, 0, 0]), "velocities is not finite"),
            (JOINTS, ([0, 0, 0], [0, 1, 0]), "the last point has the velocity [0, 1, 0]; it must be 0"),
        ):
            assert_refused("trajectory", "posture", (make.joint_trajectory(names, [(1.0, *point)]), said))
        for points, names, said in (
            ([], ["com"], "the trajectory has no points"),
            ([(1.0, [])], ["com"], "a point has 0 transforms; valid: 1"),
            ([(1.0, [AT, AT])], ["com"], "a point has 2 transforms; valid: 1"),
            ([(1.0, [AT], [AT[:6], AT[:6]])], ["com"], "a point has 2 velocities; valid: at most 1"),
            ([(1.0, [AT])], ["com", "hand"], "the trajectory has 2 joint names; valid: at most one frame"),
            ([(1.0, [[NAN, *AT[1:]]])], ["com"], "the transform is not finite"),
            ([(1.0, [AT], [[0, 0, 0, NAN, 0, 0]])], ["com"], "velocities is not finite"),
        ):
            assert_refused("trajectory", "com", (make.frame_trajectory(points, names=names), said))
        content = make.frame_trajectory([(1.0, [[0, 0, 0, 0, 0, 0, 0]])])
        assert_refused("trajectory", "hand", (content, "is not a unit quaternion"))


class TestUpdate:
    def update(self, make, text):
        return read("update", "", make.string(text))

    def test_several_changes(self, make):
        changes = self.update(
            make,
            "{tasks: {com: {weight: 5, enabled: true, setpoint: [0, 0, 0.7]}, hand: {setpoint: [1,2,3,0,0,0,1.005]},"
            " posture: {setpoint: [1, 2, 3]}, torso: {setpoint: [0, 0, 0, 1]}}, contacts: {left_foot: {enabled: off}}}",
        )
        assert changes[0] == requests.SetWeight("com", 5.0)
        assert changes[1] == requests.EnableTask("com", True)
        np.testing.assert_array_equal(changes[2].position, [0, 0, 0.7])
        np.testing.assert_array_equal(changes[3].position, [1, 2, 3, 0, 0, 0, 1])
        np.testing.assert_array_equal(changes[4].position, [1, 2, 3])
        assert changes[-1] == requests.EnableContact("left_foot", False)
        assert len(changes) == 7

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("", "'' is not a mapping; an update is YAML such as {tasks:"),
            ("a" * 4000, "'aaaaaaaaaaaa...aaaaaaaaaaaaa' is not a mapping"),
            ("{tasks: {com: ", "not valid YAML"),
            ("{tasks: !!python/object:os.system {}}", "not valid YAML"),
            ("[" * 500, "not valid YAML"),
            ("#" * 5000, "update has 5000 characters (limit 4096)"),
            ("{tasks: {com: {setpoint: [1, 2, 3], frame: 7}}}", "tasks.com.frame is 7; it must be the name of a frame"),
            (
                "{tasks: {com: {setpoint: [1, 2, 3], frame: hand/reference}}}",
                "tasks.com.frame is 'hand/reference'; valid for setpoints of task",
            ),
            (
                "{tasks: {com: {frame: com/reference}, posture: {weight: 1.0}}}",
                "tasks.com: 'frame' requires 'setpoint'",
            ),
            ("{task: {com: {weight: 1}}}", "unknown key 'task'; did you mean 'tasks'? Valid: contacts, control"),
            ("{tasks: {com: 3}}", "tasks.com is not a mapping"),
            ("{tasks: {}}", "changes nothing"),
            (
                "{tasks: {com: {weight: 5}, cmo: {weight: 1}}}",
                "unknown task 'cmo'; did you mean 'com'? Valid: com, elbow, hand",
            ),
            ("{contacts: {left: {enabled: true}}}", "unknown contact 'left'; did you mean 'left_foot'?"),
            ("{tasks: {com: {wieght: 1}}}", "tasks.com: unknown key 'wieght'; did you mean 'weight'? Valid: damping"),
            ("{tasks: {com: {weight: heavy}}}", "tasks.com.weight must be from 0 to 1e+06, not 'heavy'"),
            ("{tasks: {com: {weight: true}}}", "tasks.com.weight must be from 0 to 1e+06, not True"),
            ("{tasks: {com: {weight: .nan}}}", "tasks.com.weight must be from 0 to 1e+06, not nan"),
            (f"{{tasks: {{com: {{weight: 1{'0' * 400}}}}}}}", "tasks.com.weight: integer with 401 characters"),
            ("{tasks: {com: {weight: !!bool x}}}", "not valid YAML: KeyError: 'x'"),
            ("{tasks: {com: {weight: 1, weight: 2}}}", "tasks.com.weight: duplicate key 'weight'"),
            ("{tasks: {com: &a {weight: 1}, base: *a}}", "aliases (*name) are not supported"),
            ("{tasks: {com: {enabled: 1}}}", "tasks.com.enabled is 1; valid: true or false"),
            ("{tasks: {com: {setpoint: 1}}}", "tasks.com.setpoint has the shape (); it takes (3,)"),
            ("{tasks: {com: {setpoint: [1, 2]}}}", "tasks.com.setpoint has the shape (2,); it takes (3,)"),
            ("{tasks: {steady: {setpoint: [1, 2, 3]}}}", "tasks.steady.setpoint has the shape (3,); it takes (2,)"),
            ("{tasks: {wrist: {setpoint: [1, 2, 3, 0, 0, 0, 2]}}}", "[0, 0, 0, 2] is not a unit quaternion (norm 2)"),
            ("{tasks: {com: {setpoint: [1, 2, a]}}}", "setpoint is not an array of numbers: [1, 2, 'a']"),
            ("{tasks: {com: {setpoint: [1, 2, true]}}}", "setpoint is not an array of numbers: [1, 2, True]"),
            ("{tasks: {com: {setpoint: [1, 2, .nan]}}}", "tasks.com.setpoint is not finite"),
        ],
    )
    def test_invalid_messages_are_refused(self, make, text, said):
        assert said in input_refusal(self.update, make, text)

    @settings(max_examples=200)
    @given(text=st.text(max_size=80) | hostile_text("update"))
    def test_any_text_is_read_or_refused(self, make, text):
        try:
            changes = READERS["update"](WORDS, "", make.string(text))
        except InputRefused:
            return
        assert changes
