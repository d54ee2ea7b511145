"""Mistakes in configuration and URDF: each is refused by one sentence with location and remedy."""

import pytest
from refusals import refusal
from robot_cases import BOX, joint, link, robot

import wbc_controller as wbc

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
MOTOR = 'effort="60" velocity="10" lower="-1" upper="1"'


def part(name, mass, middle, size):
    at = f"0 0 {middle}"
    return link(name, mass, at, 0.01, BOX.format(at=at, size=size))


#: A body of 5 kg on one leg, with a sole of 200 × 100 mm, 60 mm below the ankle.
URDF = robot(
    part("body", 5, 0.1, "0.2 0.2 0.2"), part("thigh", 1, -0.1, "0.05 0.05 0.2"),
    part("shank", 1, -0.1, "0.05 0.05 0.2"), part("ankle", 0.2, 0, "0.02 0.02 0.02"),
    part("foot", 0.5, -0.04, "0.2 0.1 0.04"), link("sole"),
    joint("hip", "body", "thigh", limit=MOTOR), joint("knee", "thigh", "shank", at="0 0 -0.2", limit=MOTOR),
    joint("ankle_pitch", "shank", "ankle", at="0 0 -0.2", limit=MOTOR),
    joint("ankle_roll", "ankle", "foot", "1 0 0", limit=MOTOR),
    joint("sole_joint", "foot", "sole", at="0 0 -0.06", kind="fixed", limit=""),
)  # fmt: skip
VALUES = {
    "robot": {"joints": ["hip", "knee", "ankle_pitch", "ankle_roll"], "posture": [0.0, 0.0, 0.0, 0.0]},
    "contacts": {"foot": {"type": "surface", "frame": "sole", "half_length": 0.1, "half_width": 0.05, "friction": 0.7,
                          "max_normal_force": 300.0}},
    "tasks": {"com": {"type": "com", "weight": 50.0, "stiffness": 100.0},
              "posture": {"type": "posture", "weight": 0.01, "stiffness": 50.0}},
}  # fmt: skip
BALL = {"type": "point", "frame": "sole", "translation": [0.0, 0.0, 0.02], "radius": 0.02, "max_normal_force": 300.0}


def checked(changes=None, urdf=URDF):
    config = wbc.load(VALUES, urdf=urdf).replace(changes or {})
    return {finding.subject: finding.text for finding in wbc.check(config)}


def test_findings_of_a_sole():
    found = checked()
    assert found["contact shapes"] == "foot 200 × 100 mm on a sole of 200 × 100 mm"
    assert found["posture"].endswith("centre of mass at [0.000, 0.000, 0.434] m")
    assert found["tilt of soles"] == "against the floor: foot 0.0°"
    shapes = checked({"contacts.foot.half_length": 0.1025})["contact shapes"]
    assert shapes == "foot 205 × 100 mm on a sole of 200 × 100 mm, 2.5 mm beyond its edge: the foot may tip"
    text = checked({"robot.posture.ankle_roll": 0.06})["tilt of soles"]
    assert text.startswith("against the floor: foot 3.4°; the robot will tilt on release")


IN_THE_CONFIGURATION = {
    "a posture in degrees": ({"robot.posture.hip": 20.0},
        ["robot.posture: 20.0 rad for 'hip' is outside its limits [-1.0, 1.0] rad"]),
    "a posture that falls over": ({"robot.posture.ankle_pitch": 0.7, "robot.posture.hip": -0.7},
        ["centre of mass is", "outside the support"]),
    "whole sides in place of halves": ({"contacts.foot.half_length": 0.2, "contacts.foot.half_width": 0.1},
        ["contacts.foot: half_length and half_width reach 112 mm beyond the sole of 'sole'", "200 × 100 mm"]),
    "length and width swapped": ({"contacts.foot.half_length": 0.05, "contacts.foot.half_width": 0.1},
        ["contacts.foot: half_length and half_width are swapped", "200 × 100 mm along x and y"]),
    "a sole beside the foot": ({"contacts.foot.translation": [0.05, 0.0, 0.0]},
        ["contacts.foot: half_length and half_width reach 50 mm beyond", "about [-0.050, 0.000] m"]),
    "a sole at the ankle": ({"contacts.foot.frame": "foot"},
        ["contacts.foot: its sole is 60 mm above the lowest point", "translation: [0.000, 0.000, -0.060]"]),
    "a sole below the foot": ({"contacts.foot.translation": [0.0, 0.0, -0.1]},
        ["contacts.foot: its sole is 100 mm below the lowest point", "translation: [0.000, 0.000, 0.000]"]),
    "a sole upside down": ({"contacts.foot.rpy": [3.14159, 0.0, 0.0]},
        ["contacts.foot.rpy: the sole is upside down", "turn it by 3.14159"]),
    "a tilted sole": ({"contacts.foot.rpy": [0.0, 0.12, 0.0]},
        ["contacts.foot.rpy: the sole is tilted by 6.9°", "allowed 5°"]),
    "a foot on the shank": ({"contacts.foot": None, "contacts.ball": {**BALL, "frame": "thigh"}},
        ["contacts.ball: its lowest point (radius = 0.02) is 200 mm above the lowest point", "frame or translation"]),
    "a diameter in the wrong unit": ({"contacts.foot": None, "contacts.ball": {**BALL, "radius": 0.31}},
        ["contacts.ball: its lowest point (radius = 0.31) is 290 mm below the lowest point"]),
    "a ball beside the foot": ({"contacts.foot": None, "contacts.ball": {**BALL, "translation": [0.2, 0.0, 0.02]}},
        ["contacts.ball: its lowest point", "is 100 mm beside the footprint of 'sole'"]),
    "friction of ice": ({"contacts.foot.friction": 0.02}, ["contacts.foot.friction = 0.02", "rubber on a floor"]),
    "contradictory forces": ({"contacts.foot.min_normal_force": 500.0},
        ["contacts.foot", "min_normal_force = 500.0 is larger than max_normal_force = 300.0"]),
    "no contact": ({"contacts.foot.enabled": False}, ["contacts: none is enabled", "falls"]),
}  # fmt: skip


@pytest.mark.parametrize("mistake", IN_THE_CONFIGURATION)
def test_a_mistake_in_the_configuration(mistake):
    changes, said = IN_THE_CONFIGURATION[mistake]
    sentence = refusal(checked, changes)
    assert "\n" not in sentence
    assert [part for part in said if part not in sentence] == [], sentence


WRENCH = {"type": "contact_wrench"}
GRIP = {"type": "fixed", "frame": "left_rubber_hand", "max_force": 300.0, "max_moment": 50.0}
#: Masks of held axes, by the free axes along which motions can displace a link; the first is a skate.
NONHOLONOMIC = {"along y": (0, 1, 1, 1, 1, 0), "about x": (1, 1, 1, 1, 0, 0), "along x and along y": (1, 1, 0, 0, 0, 0)}


@pytest.mark.parametrize(
    ("robot", "changes", "said"),
    [
        ("g1", {"walking.left": "hand"}, "'hand' is not a surface contact; valid: left_foot, right_foot"),
        ("g1", {"walking.right": None}, "walking.left = 'left_foot', walking.right = None: walking takes two surface"),
        ("g1", {"walking.right": "left_foot"}, "two surface contacts"),
        ("g1", {"tasks.walking_com": {"type": "com"}}, "tasks.walking_com: the walker has a task of this name"),
        ("g1", {"walking.gait": "trot"}, "walking.gait = 'trot' takes four point contacts and no surface contact"),
        ("go2", {"walking.width": 0.2}, "walking.width: a robot with four point contacts has no such key"),
        ("go2", {"contacts.rear_left_foot": None}, "takes four point contacts and no surface contact"),
        ("go2", {"tasks.walking_com": {"type": "com"}}, "tasks.walking_com: the walker has a task of this name"),
        ("go2", {"robot.friction": {"FL_calf": {"dry": 1.0}}}, "unknown joint 'FL_calf'; did you mean 'FL_calf_joint'"),
        ("g1", {"tasks.posture.tolerance": [0.1, 0.2]}, r"posture\.tolerance: 2 values; .* 29 values"),
        ("go2", {"tasks.posture.stiffness": [50.0] * 2}, r"posture\.stiffness has 2 values; .* the task's 12 axes"),
        ("g1", {"tasks.effort": WRENCH | {"contact": "left_hand"}}, "unknown contact 'left_hand'; .*left_foot"),
        ("go2", {"tasks.effort": WRENCH | {"contact": "front_left_foot", "mask": [False] * 3 + [True] * 3}},
         r"tasks\.effort\.mask selects no force .* of contact 'front_left_foot'; valid: x, y, z"),
        ("g1", {"tasks.effort": {"type": "torque", "target": [1.0]}}, "target has 1 values; expected 29, one per"),
        ("g1", {"tasks.effort": {"type": "torque", "joints": ["knee"]}}, "joints: 'knee' is not one of robot.joints"),
        *(("go2", {"tasks.paw": {"type": kind, "frame": "FL_fot"}}, r"paw\.frame = 'FL_fot'.*did you mean 'FL_foot'")
          for kind in ("frame_position", "frame_orientation", "frame_pose")),
        ("go2", {"tasks.paw": {"type": "relative_pose", "frame": "FL_foot", "reference_frame": "bse"}},
         "reference_frame = 'bse'.*did you mean 'base'"),
        ("g1", {"contacts.grip": GRIP | {"against": "left_hnd"}}, r"grip\.against = 'left_hnd'.*no such frame"),
        ("g1", {"contacts.grip": GRIP | {"against": "left_wrist_yaw_link"}}, "against = .*: no joint is between it"),
        ("g1", {"loops.bar": {"frame_a": "left_wrist_yaw_link", "frame_b": "left_rubber_hand"}},
         r"loops\.bar: no joint is between frame_a = 'left_wrist_yaw_link' and frame_b = 'left_rubber_hand'"),
        *(("g1", {"contacts.grip": GRIP | {"mask": [bool(held) for held in mask], "stiffness": 30.0}},
           rf"contacts\.grip\.stiffness = 30: with mask = .*link {free}, so") for free, mask in NONHOLONOMIC.items()),
        *(("g1", {"solver.name": name, "tasks.posture.level": 1}, rf"solver.name = '{name}'.*level.*tolerance.*daqp")
          for name in ("osqp", "proxqp")),
    ],
)  # fmt: skip
def test_a_mistake_in_the_settings_of_a_shipped_robot(robot, changes, said):
    with pytest.raises(wbc.ConfigurationError, match=said):
        wbc.Controller(wbc.load(robot).replace(changes))


MASS, LIMIT = '<mass value="1"/>', f"<limit {MOTOR}/>"
IN_THE_URDF = {
    "mass without inertia": (f"{MASS}{INERTIA}", MASS + INERTIA.replace("0.01", "0"),
        ["link 'thigh', moved by joint 'hip', has 1 kg", "requires a mass", "three positive moments"]),
    "a massless thigh": (f'<inertial><origin xyz="0 0 -0.1"/>{MASS}{INERTIA}</inertial>', "",
        ["link 'thigh', moved by joint 'hip', has 0 kg", "requires a mass"]),
    "no velocity limit": (LIMIT, LIMIT.replace('velocity="10"', 'velocity="0"'),
        ["joint 'hip' has the velocity limit 0.0", "robot.joint_limits.hip.velocity"]),
    "no effort limit": (LIMIT, LIMIT.replace('effort="60"', 'effort="0"'),
        ["joint 'hip' has the effort limit 0.0", "robot.joint_limits.hip.effort"]),
    "millimetres": ('<origin xyz="0 0 -0.2"/>', '<origin xyz="0 0 -200"/>',
        ["joint 'knee' is 200 m from its parent joint", "metres"]),
    "an inertial far away": ('<origin xyz="0 0 0.1"/><mass', '<origin xyz="1e20 0 0.1"/><mass',
        ["the centre of mass is 6.49e+19 m outside the support", "origins of the <inertial>"]),
}  # fmt: skip


@pytest.mark.parametrize("mistake", IN_THE_URDF)
def test_a_mistake_in_the_urdf(mistake):
    right, wrong, said = IN_THE_URDF[mistake]
    assert right in URDF
    sentence = refusal(checked, {}, URDF.replace(right, wrong, 1))
    assert "robot.urdf" in sentence or "centre of mass" in sentence
    assert "\n" not in sentence
    assert [part for part in said if part not in sentence] == [], sentence


def test_implausible_limits_are_reported_and_can_be_replaced():
    wild = URDF.replace('effort="60" velocity="10"', 'effort="1e4" velocity="2000"', 1)
    effort, velocity = [finding.text for finding in wbc.check(wbc.load(VALUES, urdf=wild))
                        if finding.subject == "implausible"]  # fmt: skip
    assert effort.startswith("effort limits of hip 10000 N·m: weight times size of the robot is ")
    assert velocity.startswith("velocity limits of hip 2000 rad/s: ")
    found = checked({"robot.joint_limits.hip": {"effort": 40.0, "velocity": 12.0}}, wild)
    assert "implausible" not in found
    assert found["joint limits"] == "of the configuration: hip effort 40, velocity 12"
    assert found["effort limits"] == "40 to 60 N·m"


def test_uncontrolled_locked_and_floating_joints_are_reported():
    assert "uncontrolled" not in checked()
    assert checked({"tasks.posture": None})["uncontrolled"].startswith("hip, knee, ankle_pitch")
    changes = {"robot.joints": ["hip", "knee", "ankle_pitch"], "robot.posture": [0.0, 0.0, 0.0]}
    assert checked(changes)["locked joints"] == "ankle_roll (at 0 by default)"
    aside = '<joint name="ball" type="floating"><parent link="PARENT"/><child link="load"/></joint></robot>'
    load = URDF.replace("</robot>", part("load", 1, 0, "0.1 0.1 0.1") + aside)
    assert checked({"contacts.foot.half_length": 0.1}, load.replace("PARENT", "foot"))["locked joints"] == (
        "ball (floating in the URDF; only the root link can float)"
    )
    assert "locked joints" not in checked({}, load.replace("PARENT", "body"))


def test_unusual_joints_and_links_are_right_and_reported():
    inertial = f'<inertial><origin xyz="0 0 0"/><mass value="0.2"/>{INERTIA}</inertial>'
    assert inertial in URDF  # ankle: pitch and roll are coincident
    assert checked({}, URDF.replace(inertial, ""))["mass"].startswith("7.50 kg")
    endless = URDF.replace('name="hip" type="revolute"', 'name="hip" type="continuous"')
    assert checked({}, endless)["no position limits"] == "hip"
    bare = URDF.replace(BOX.format(at="0 0 -0.04", size="0.2 0.1 0.04"), "")
    assert bare != URDF
    assert checked({}, bare)["not compared"].startswith("foot with the URDF: no readable <collision> on their")


def test_reserves_agree_with_statics():
    """Upright: push = weight × lever of the sole's edge / height of the centre of mass."""
    found = checked()
    height = 0.434
    weight = 7.7 * 9.81
    for side, edge in (("forward", 100.0), ("left", 50.0)):
        assert f"{edge:.0f} mm {side}" in found["sway"]
        assert f"{weight * 1e-3 * edge / height:.0f} N {side}" in found["push"]
    weak = checked({"robot.joint_limits.ankle_pitch.effort": 3.0})["sway"]
    assert "mm forward (ankle_pitch)" in weak
    assert float(weak.split(": ")[1].split(" mm forward")[0]) < 60.0
    assert "straight down" in found["squat"]
