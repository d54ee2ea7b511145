"""Findings and refusals of `wbc check`."""

import re
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from refusals import refusal

from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.check import contact_shapes
from wbc_controller.controller.check.preflight import check, longest_ramp, support_margin
from wbc_controller.controller.controller import Controller
from wbc_controller.settings.config import load


def findings(settings):
    return {finding.subject: finding.text for finding in check(settings)}


@cache
def shipped(robot_of, name):
    return findings(robot_of(name)[0])


def without_walking(robot_of, name):
    """Return settings without walking: the check of the gait takes most of the time."""
    return robot_of(name)[0].model_copy(update={"walking": None})


@pytest.mark.parametrize(
    ("name", "joints", "contacts", "slow", "fast"),
    [("g1", 29, 2, 0.45, 0.65), ("talos", 30, 2, 0.3, 0.4), ("go2", 12, 4, 0.8, 2.0)],
)
def test_findings_of_shipped_robots(robot_of, name, joints, contacts, slow, fast):
    """In simulation, G1 reaches 0.5 m/s with 0.5 and 0.6 m/s commanded; Talos walks at 0.3, and falls at 0.4 m/s."""
    settings, model = robot_of(name)
    found = shipped(robot_of, name)
    flat, talos = name != "go2", name == "talos"
    assert list(found) == [
        "joints", "mass", *(["inertias"] if talos else []), "effort limits", "tasks", "contacts", "solver",
        "centre of mass", "standing", "contact shapes", "posture", *(["tilt of soles"] if flat else []),
        *(["locked joints"] if talos else []), "push", "sway", "squat",
        "walking", *(["single support"] if flat else []),
    ]  # fmt: skip
    assert found["joints"].startswith(f"{joints} actuated, base floating")
    assert found["mass"] == f"{model.mass:.2f} kg, weight {9.81 * model.mass:.1f} N"
    assert found["contacts"].count("(") == contacts
    assert found["centre of mass"].endswith("mm inside the edge of the support")
    assert found["standing"].startswith("possible on " + ", ".join(settings.contacts))
    share = float(found["standing"].split(", ")[-1].split(" %")[0])
    assert 0.0 < share < 100.0
    pattern = r"feasible: (\d\.\d\d) m/s forward \((velocity of \w+_joint|friction and size of \w+)\), "
    assert slow < float(re.match(pattern, found["walking"])[1]) < fast
    shares = [int(share) for share in re.findall(r"(\d+) %", found.get("single support", ""))]
    assert len(shares) == (2 if flat else 0)
    assert max(shares, default=0) < 70


@pytest.mark.parametrize(("changes", "said"), [
    ({"walking": {"max_speed": 0.9, "least_width": 0.05}}, {
        "walking": "walking.max_speed = 0.90 m/s is larger",
        "warning": "least_width = 0.050 m: the shapes of the feet touch at a dist",
    }),
    ({"robot": {"effort_limit_scale": 0.2}}, {"warning": "right_foot cannot bear the robot alone; torque of right_"}),
    ({"tasks": {"pelvis": {"enabled": False}}}, {"sway": "mm forward"}),
])  # fmt: skip
def test_limits_of_walking_are_reported(robot_of, changed, changes, said):
    found = findings(changed(robot_of("g1")[0], changes))
    assert {subject for subject, text in said.items() if text in found[subject]} == set(said)


SOLO_8 = "package://example-robot-data/robots/solo_description/robots/solo.urdf"


@pytest.mark.parametrize(("leans", "sideways"), [(False, range(3)), (True, range(10, 40))])
def test_redundant_contacts_are_named_and_limit_the_sway(changed, leans, sideways):
    """Solo 8 has no hip abduction: it sways sideways only with a leaning base."""
    found = findings(changed(new_configuration(SOLO_8).settings, {"tasks": {"base": {"enabled": not leans}}}))
    feet = "FL_FOOT, FR_FOOT, HL_FOOT, HR_FOOT"
    assert found["redundant contacts"].startswith(f"2 of 12 constrained directions, at {feet}: no joint moves")
    sway = {side: int(mm) for mm, side in re.findall(r"(\d+) mm (\w+)", found["sway"])}
    assert sway["left"] in sideways
    assert sway["right"] in sideways
    assert "left (reach)" in found["sway"]
    assert min(sway["forward"], sway["back"]) > 100


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"robot.friction": {"FL_calf": {"dry": 1.0}}}, ["unknown joint 'FL_calf'; did you mean 'FL_calf_joint'"]),
        ({"estimation.imu_frame": "imuu"}, ["estimation.imu_frame = 'imuu': the robot has no such frame"]),
        ({"estimation.absolute_pose": True, "estimation.pose_frame": "bse"},
         ["estimation.pose_frame = 'bse': the robot has no such frame"]),
        ({"robot.posture.FL_thigh_joint": 1.2, "robot.posture.FL_calf_joint": -2.3},
         ["robot.posture: with the base upright these contacts reach above the floor", "front_left_foot",
          "(allowed 6 mm)"]),
    ],
)  # fmt: skip
def test_unknown_joints_and_frames_and_feet_on_different_heights_are_refused(changes, said):
    sentence = refusal(check, load("go2").replace({"estimation.base_state": "imu", **changes}))
    assert [part for part in said if part not in sentence] == [], sentence


def test_a_line_of_contacts_is_no_support(robot_of, changed):
    """The posture is an equilibrium, but an unstable one."""
    settings, model = robot_of("g1")
    data = model.pinocchio.createData()
    com = pin.centerOfMass(model.pinocchio, data, model.configuration(model.posture))
    foot = settings.contacts["left_foot"]
    ankle = pin.updateFramePlacement(model.pinocchio, data, model.frame_id(foot.frame, "frame")).translation
    point = {"type": "point", "friction": 0.7, "max_normal_force": 1000.0}
    point["translation"] = [float(com[0] - ankle[0]), 0.0, foot.translation[2] + 0.02]
    points = {name: point | {"frame": contact.frame} for name, contact in settings.contacts.items()}
    bare = settings.model_copy(update={"contacts": {}, "walking": None})
    sentence = refusal(check, changed(bare, {"contacts": points}))
    assert sentence.startswith("the robot cannot stand still in robot.posture on left_foot, right_foot: the centre of ")
    assert "mass is above the edge of the support; a sway of 1 mm must be possible, not only 0.0 mm forward" in sentence


@pytest.mark.parametrize(
    ("robot", "ramp", "longest", "fastest"),
    [("g1", 0.2, 0.2, "right_elbow_joint"), ("g1", 0.5, 0.2, "right_elbow_joint"),
     ("talos", 0.2, 0.1, "arm_right_4_joint"), ("go2", 60.0, 60.0, None)],
)  # fmt: skip
def test_arms_fall_during_the_activation_ramp(robot_of, changed, robot, ramp, longest, fastest):
    """In simulation on the hoist, the elbows of G1 move by 0.31 rad in 0.2 s and by 0.73 rad in 0.5 s."""
    settings, model = without_walking(robot_of, robot), robot_of(robot)[1]
    settings = changed(settings, {"safety": {"activation_ramp": ramp}})
    found = longest_ramp(settings, make_qp(settings, model))
    assert found[0] == longest
    assert fastest in (None, found[1])
    text = f"safety.activation_ramp = {ramp:g} s: unsupported joints fall meanwhile ({fastest} fastest), "
    warning = findings(settings).get("warning", "")
    assert warning.startswith(text) is (longest < ramp)
    assert f"use at most {longest:g} s" in warning or longest == ramp


def test_too_small_a_normal_force(robot_of, changed):
    settings, model = without_walking(robot_of, "go2"), robot_of("go2")[1]
    weak = {name: {"max_normal_force": 39.0} for name in settings.contacts}
    sentence = refusal(check, changed(settings, {"contacts": weak}))
    weight = model.mass * model.gravity
    assert f"max_normal_force adds up to 156 N, and the robot weighs {weight:.1f} N" in sentence
    assert "; conflict: normal force of " in sentence
    assert "(at most 39 N, " in sentence
    assert "torque" not in sentence
    enough = {name: {"max_normal_force": 60.0} for name in settings.contacts}
    assert "standing" in findings(changed(settings, {"contacts": enough}))


def test_a_fixed_base_needs_no_contact_but_enough_effort(robot_of, changed):
    """The limbs are loaded by gravity."""
    bare = without_walking(robot_of, "g1").model_copy(update={"contacts": {}})
    found = findings(changed(bare, {"robot": {"base": "fixed"}}))
    assert found["contacts"] == "none"
    assert "centre of mass" not in found
    assert found["standing"].startswith("possible on no contact")
    sentence = refusal(check, changed(bare, {"robot": {"base": "fixed", "effort_limit_scale": 0.02}}))
    assert sentence.startswith(
        "the robot cannot stand still in robot.posture on its fixed base: gravity needs more than the effort limit of "
    )
    assert " N·m" in sentence
    assert "_joint " in sentence


@pytest.mark.parametrize("scale", [0.01, 1e-310])
def test_too_small_an_effort_on_the_feet(robot_of, changed, scale):
    settings, model = robot_of("go2")
    weak = changed(settings, {"robot": {"effort_limit_scale": scale}})
    assert longest_ramp(weak, make_qp(weak, model))[0] == weak.safety.activation_ramp  # no other ramp would help
    sentence = refusal(check, weak)
    assert "no contact forces within friction and the supports carry the weight within the effort limits" in sentence
    assert "robot.effort_limit_scale" in sentence
    assert "; conflict: torque of " in sentence
    assert "N·m more needed)" in sentence


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("corners", "position", "margin"),
    [(SQUARE, (0.5, 0.5), 0.5), (SQUARE, (0.1, 0.5), 0.1), (SQUARE, (0.0, 0.5), 0.0), (SQUARE, (1.2, 0.5), -0.2),
     (SQUARE, (0.5, -3.0), -3.0), ([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], (1.0, 0.5), -0.5),
     ([[0.0, 0.0], [1.0, 0.0]], (0.5, 0.0), 0.0), ([[0.0, 0.0]], (0.0, 0.2), -0.2)],
)  # fmt: skip
def test_the_margin_of_a_square_and_of_a_line_without_inside(corners, position, margin):
    assert support_margin(np.array(corners), np.array(position)) == pytest.approx(margin)


def test_a_posture_that_leaves_a_loop_open(robot_of, changed):
    settings = without_walking(robot_of, "g1")
    loop = {"frame_a": "left_rubber_hand", "frame_b": "right_rubber_hand", "mask": [True] * 3 + [False] * 3}
    sentence = refusal(check, changed(settings, {"loops": {"bar": loop}}))
    assert sentence.startswith("robot.posture: position error of the loop 'bar': [-0.069 m, -0.438 m, 0.0576 m] along")
    closing = {"translation_a": [-0.06902, -0.43850, 0.05761]}
    assert findings(changed(settings, {"loops": {"bar": loop | closing}}))["loops"] == "bar: closed in the posture"


def test_feet_on_a_slope(robot_of, changed):
    settings = without_walking(robot_of, "g1")
    posture = list(settings.robot.posture)
    for side in ("left", "right"):
        posture[settings.robot.joints.index(f"{side}_ankle_pitch_joint")] -= 0.2
    bent = changed(settings, {"robot": {"posture": posture}})
    assert "above the floor" in refusal(check, bent)
    found = findings(changed(bent, {"mock": {"floor_normal": [-np.sin(0.2), 0.0, np.cos(0.2)]}}))
    assert found["centre of mass"].endswith("inside the edge of the support")


def test_hand_on_rail_or_wall_is_no_floor_contact(robot_of, changed):
    settings = without_walking(robot_of, "g1")
    rail = {"type": "fixed", "frame": "left_rubber_hand", "max_force": 50.0, "max_moment": 5.0}
    wall = {"type": "point", "frame": "right_rubber_hand", "normal": [-1.0, 0.0, 0.0], "max_normal_force": 50.0}
    found = findings(changed(settings, {"contacts": {"rail": rail, "wall": wall}}))
    assert found["centre of mass"] == shipped(robot_of, "g1")["centre of mass"]
    assert found["standing"].startswith("possible on left_foot, right_foot, rail, wall; ")
    hanging = {foot: {"enabled": False} for foot in settings.contacts}
    sentence = refusal(check, changed(settings, {"contacts": hanging | {"rail": rail}}))
    assert "conflict: force of rail (at most 50 N" in sentence or "moment of rail" in sentence


ARMS = ("left_elbow_joint", "right_elbow_joint")


def test_finding_of_joints_and_actuators(robot_of, changed):
    settings = without_walking(robot_of, "g1")

    def sprung(axis):
        ankles = {f"{side}_ankle_{axis}_joint": {"stiffness": 40.0, "rest": -0.1} for side in ("left", "right")}
        return changed(settings, {"robot": {"passive_joints": ankles}})

    found = findings(sprung("roll"))
    assert found["joints"].startswith("29, 27 actuators, 2 passive, base floating")
    assert "passive joints" not in found  # the ground carries the remaining load
    # The springs determine the centre of pressure in pitch.
    assert "and the springs of left_ankle_pitch_joint, right_ankle_pitch_joint" in refusal(check, sprung("pitch"))


def test_unbalanced_springs_are_reported_with_balanced_rest(robot_of, changed):
    settings = without_walking(robot_of, "g1")

    def sprung(rests):
        springs = {name: {"stiffness": 40.0, "rest": rest} for name, rest in rests.items()}
        return findings(changed(settings, {"robot": {"passive_joints": springs}}))

    found = sprung(dict.fromkeys(ARMS, 0.6))["passive joints"]
    said = re.findall(r"(\w+_elbow_joint) by (\S+) N·m \(balanced by rest: (\S+)\)", found)
    assert [name for name, *_ in said] == list(ARMS)
    assert all(float(torque) > 0.0 for _, torque, _ in said)  # gravity extends the bent arms
    assert "passive joints" not in sprung({name: float(rest) for name, _, rest in said})


def test_the_start_of_a_controller_reads_no_meshes_and_names_an_upside_down_sole(robot_of, monkeypatch, changed):
    settings, _ = robot_of("talos")
    monkeypatch.setattr(contact_shapes, "read_shapes", lambda *_: pytest.fail("the meshes were read"))
    assert Controller(settings).mode.name == "INACTIVE"
    sentence = refusal(Controller, changed(settings, {"contacts": {"left_foot": {"rpy": [3.14159, 0.0, 0.0]}}}))
    assert "contacts.left_foot.rpy: the sole is upside down" in sentence
    assert "\n" not in sentence
