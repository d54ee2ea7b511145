"""Draft of a configuration from a URDF: measured feet, a standing posture, and notes."""

import re

import numpy as np
import pytest
import yaml
from refusals import refusal
from robot_cases import SOLE, biped, joint, link, robot

from wbc_controller.apps.new.draft import TITLE, new_configuration
from wbc_controller.apps.new.notes import Draft, identifier
from wbc_controller.controller.check.preflight import check
from wbc_controller.settings.resources import locate

ROBOTS = "package://example-robot-data/robots/"
G1 = ROBOTS + "g1_description/urdf/g1_29dof_rev_1_0.urdf"
GO1 = ROBOTS + "go1_description/urdf/go1.urdf"
PANDA = ROBOTS + "panda_description/urdf/panda.urdf"
LEGS = ("front_left", "front_right", "rear_left", "rear_right")


def said(draft, key, origin):
    """Return the notes of an origin on a key as one text."""
    return " ".join(note.comment for note in draft.notes if note.key.startswith(key) and note.origin == origin)


def wagon(*, wheel="cylinder", limit="effort='20' velocity='20'", kind="continuous", root="box"):
    """Return the URDF of a box on four legs with hip, knee and a wheel or box at each end."""
    shape = {
        "cylinder": "<origin rpy='1.5707963 0 0'/><geometry><cylinder radius='0.1' length='0.04'/></geometry>",
        "box": "<geometry><box size='0.12 0.06 0.02'/></geometry>",
    }.get(wheel)
    collision, bounded = f"<collision>{shape}</collision>" if shape else "", f"{limit} lower='-1.5' upper='1.5'"
    parts = [link(root, 10.0)]
    for name, at in zip(LEGS, ("0.3 0.2 0", "0.3 -0.2 0", "-0.3 0.2 0", "-0.3 -0.2 0"), strict=True):
        last = limit if kind == "continuous" else bounded
        parts += [
            link(f"{name}_thigh", 0.5), joint(f"{name}_hip", root, f"{name}_thigh", at=at, limit=bounded),
            link(f"{name}_shank", 0.5),
            joint(f"{name}_knee", f"{name}_thigh", f"{name}_shank", at="0 0 -0.25", limit=bounded),
            link(f"{name}_end", 0.5, more=collision),
            joint(f"{name}_last", f"{name}_shank", f"{name}_end", at="0 0 -0.25", kind=kind, limit=last),
        ]  # fmt: skip
    return robot(*parts)


@pytest.fixture(scope="module")
def g1():
    return new_configuration(G1)


def test_rotor_inertia_follows_from_the_weakest_joint_of_the_legs(g1):
    """G1's ankles have 35 N·m; its wrists, 5 N·m, and an arm without legs do not count."""
    assert g1.values["robot"]["armature"] == pytest.approx(0.0035)
    assert "from the data sheet" in said(g1, "robot.armature", "missing")
    assert new_configuration(PANDA).values["robot"]["armature"] == 0.0


def test_soles_and_posture_of_a_humanoid(g1):
    """The URDF has balls of 5 mm at (0.12, ±0.03) and (-0.05, ±0.025) below each ankle."""
    contacts = g1.values["contacts"]
    assert list(contacts) == ["left_ankle_roll_link", "right_ankle_roll_link"]
    for contact in contacts.values():
        corners = np.array(contact["vertices"]) + contact["translation"][:2]
        for ball in ([0.12, 0.03], [0.12, -0.03], [-0.05, 0.025], [-0.05, -0.025]):
            assert np.linalg.norm(corners - ball, axis=1).min() < 0.002
        assert np.ptp(corners, axis=0) == pytest.approx([0.17, 0.06], abs=0.004)
        assert contact["translation"][2] == pytest.approx(-0.035, abs=1e-6)
    joints = dict(zip(g1.values["robot"]["joints"], g1.values["robot"]["posture"], strict=True))
    assert 0.3 < joints["left_knee_joint"] < 1.2
    for name, position in joints.items():
        if name.startswith("left_") and ("hip" in name or "knee" in name or "ankle" in name):
            sign = 1.0 if "pitch" in name or "knee" in name else -1.0
            assert joints[name.replace("left", "right")] == pytest.approx(sign * position, abs=1e-6)
    (found,) = (finding.text for finding in check(g1.settings) if finding.subject == "centre of mass")
    assert "inside the edge of the support" in found


def test_balls_are_points_and_an_arm_has_a_fixed_base():
    draft = new_configuration(str(locate(GO1)))
    assert draft.values["robot"]["urdf"] == GO1  # the address of a path in an installed package
    contacts = draft.values["contacts"]
    assert list(contacts) == ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]
    assert {contact["radius"] for contact in contacts.values()} == {0.02}
    assert all(contact["type"] == "point" and "translation" not in contact for contact in contacts.values())
    draft = new_configuration(PANDA)
    assert draft.values["robot"]["base"] == "fixed"
    assert draft.values["robot"]["joints"] == [f"panda_joint{number}" for number in range(1, 8)]
    assert {"contacts", "walking"}.isdisjoint(draft.values)
    assert "panda_finger_joint1" in said(draft, "robot.joints", "guess")
    check(draft.settings)


def test_wheels_flat_boxes_and_feet_without_a_shape(drafted):
    values = drafted(wagon()).values
    assert "joint_limits" not in values["robot"]  # those of the URDF are kept
    assert "walking" not in values
    contacts = values["contacts"]
    assert list(contacts) == [f"{leg}_end" for leg in LEGS]
    for contact in contacts.values():
        assert contact["type"] == "rolling"
        assert contact["radius"] == pytest.approx(0.1, abs=1e-4)
        assert np.abs(contact["axis"]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
    contact = drafted(wagon(wheel="box", kind="revolute")).values["contacts"]["front_left_end"]
    assert (contact["half_length"], contact["half_width"]) == (0.06, 0.03)
    assert contact["translation"] == [0.0, 0.0, -0.01]
    draft = drafted(wagon(wheel="none"))
    assert {contact["type"] for contact in draft.values["contacts"].values()} == {"point"}
    assert "front_left_end" in said(draft, "contacts.front_left_end.radius", "missing")


@pytest.mark.parametrize(
    ("limit", "kind", "word"),
    [
        ("effort='0' velocity='20'", "effort", "largest torque"),
        ("effort='5000' velocity='20'", "effort", "5000"),
        ("effort='20' velocity='0'", "velocity", "largest speed"),
        ("effort='20' velocity='1000'", "velocity", "1000"),
    ],
)
def test_implausible_limits_are_replaced_and_reported(drafted, limit, kind, word):
    draft = drafted(wagon(limit=limit))
    assert set(draft.values["robot"]["joint_limits"]["rear_left_knee"]) == {kind}
    assert word in said(draft, "robot.joint_limits", "missing")
    assert "rear_left_knee" in said(draft, "robot.joint_limits", "missing")


def test_options_for_base_and_feet(drafted):
    assert drafted(wagon(root="world")).values["robot"]["base"] == "fixed"
    assert drafted(wagon(), base="fixed").values["robot"]["base"] == "fixed"
    draft = drafted(wagon(), base="floating", feet=["rear_left_end", "front_left_end", "rear_right_end"])
    assert set(draft.values["contacts"]) == {"rear_left_end", "front_left_end", "rear_right_end"}
    unknown = refusal(drafted, wagon(), feet=["front_left_nd"])
    assert "--feet: unknown moving link 'front_left_nd'; did you mean 'front_left_end'" in unknown


def srdf(tmp_path, hip, knee):
    """Write an SRDF with a posture of the wagon, and return its path."""
    joints = "".join(
        f"<joint name='{leg}_hip' value='{hip}'/><joint name='{leg}_knee' value='{knee}'/>" for leg in LEGS
    )
    path = tmp_path / "robot.srdf"
    states = f"<group_state name='zero' group='all'/><group_state name='half_sitting' group='all'>{joints}"
    path.write_text(f"<robot name='wagon'>{states}</group_state></robot>", encoding="utf-8")
    return str(path)


def test_postures_of_an_srdf(drafted, tmp_path):
    draft = drafted(wagon(), srdf=srdf(tmp_path, 0.4, -0.8))
    assert set(draft.values["robot"]["posture"]) == {0.4, -0.8, 0.0}
    assert "half_sitting" in said(draft, "robot.posture", "found")
    draft = drafted(wagon(), srdf=srdf(tmp_path, 1.2, 0.0))
    assert "half_sitting" in said(draft, "robot.posture", "guess")
    assert "centre of mass" in said(draft, "robot.posture", "guess")
    check(draft.settings)
    draft = drafted(wagon(), base="fixed", srdf=srdf(tmp_path, 1.5, 0.2))
    assert set(draft.values["robot"]["posture"]) == {1.47, 0.2, 0.0}
    assert "front_left_hip" in said(draft, "robot.posture", "guess")
    assert "knee" not in said(draft, "robot.posture", "guess")
    invalid = refusal(drafted, wagon(), srdf=srdf(tmp_path, "bent", 0.0))
    assert "'half_sitting': invalid position of joint 'front_left_hip': 'bent'; valid" in invalid


def test_notes_are_comments_of_the_file(g1):
    text = g1.to_yaml(TITLE)
    assert yaml.safe_load(text)["wbc_controller"]["ros__parameters"] == g1.values
    assert max(map(len, text.splitlines())) <= 120
    comments = " ".join(line.strip("# ") for line in text.splitlines() if line.lstrip().startswith("#"))
    assert len(g1.open_points) > 4
    for doubt in g1.open_points:
        assert doubt.split(": ", 1)[1] in comments
    draft = Draft()
    draft.put("contacts.foot", {"type": "point", "radius": 0.01})
    draft.note("contacts.foot.radius", "measure it.", "missing")
    assert "# radius: Fill in: measure it.\n      foot: {type: point, radius: 0.01}\n" in draft.to_yaml("")
    assert [identifier(name) for name in ("l-foot", "1_sole", "sole")] == ["l_foot", "_1_sole", "sole"]


@pytest.mark.parametrize(("urdf", "walks"), [
    ("romeo_description/urdf/romeo_small.urdf", True),
    ("hyq_description/robots/hyq_no_sensors.urdf", True),
    ("solo_description/robots/solo.urdf", False),  # legs that move in planes
    ("bolt_description/robots/bolt.urdf", False),  # two point feet
])  # fmt: skip
def test_bipeds_with_soles_and_quadrupeds_walk(urdf, walks):
    draft = new_configuration(ROBOTS + urdf)
    assert set(draft.values.get("walking", {})) in ([{"gait"}, {"left", "right"}] if walks else [set()])
    assert "{}" not in draft.to_yaml(TITLE)  # the parser of ROS 2 parameter files refuses empty sections
    assert ("\n    walking:\n" in draft.to_yaml(TITLE)) is walks


def test_legs_of_five_joints_and_weak_legs_do_not_walk(drafted):
    """Their soles cannot have any pose."""
    draft = drafted(biped())
    assert [contact["type"] for contact in draft.values["contacts"].values()] == ["surface", "surface"]
    assert "walking" not in draft.values
    assert "the joints of a leg cannot move its foot in all directions" in said(draft, "walking", "guess")
    text = locate(G1).read_text(encoding="utf-8")
    draft = drafted(re.sub(r'effort="([\d.]+)"', lambda found: f'effort="{0.15 * float(found[1])}"', text))
    assert "walking" not in draft.values
    assert "one leg cannot bear the robot (torque of " in said(draft, "walking", "guess")


def test_slow_legs_do_not_walk(drafted):
    text = re.sub(r'velocity="[\d.]+"', 'velocity="0.3"', locate(G1).read_text(encoding="utf-8"))
    draft = drafted(text)
    assert "walking" not in draft.values
    assert "0.05 m/s forward is not feasible (velocity of " in said(draft, "walking", "guess")


def with_ankle_pitch(limit):
    """Return G1's URDF with another limit of its ankles' pitch."""
    return re.sub(r'<limit lower="-0.87267" upper="0.5236"[^/]*/>', limit, locate(G1).read_text(encoding="utf-8"))


def test_small_ranges_of_the_ankles_leave_room_for_a_squat(drafted, g1):
    """The leg is bent by a share of the travel that the ankles permit, not by 6 % of its length."""
    draft = drafted(with_ankle_pitch('<limit lower="-0.35" upper="0.5" effort="35" velocity="30"/>'))
    bent, straight = (
        dict(zip(each.values["robot"]["joints"], each.values["robot"]["posture"], strict=True)) for each in (g1, draft)
    )
    assert bent["left_ankle_pitch_joint"] < -0.3
    assert -0.2 < straight["left_ankle_pitch_joint"] < -0.05
    assert "walking" in draft.values


def test_robots_with_weak_ankles_stand_above_them(drafted):
    """In the middle of the soles, 35 mm before the ankles, each ankle would need 6 N·m."""
    draft = drafted(with_ankle_pitch('<limit lower="-0.87267" upper="0.5236" effort="4" velocity="30"/>'))
    (found,) = (finding.text for finding in check(draft.settings) if finding.subject == "standing")
    assert found.startswith("possible")


def test_missing_meshes(drafted):
    """Collision elements with missing meshes are noted, and visual elements are not necessary."""
    mesh = '<{0}><geometry><mesh filename="package://no_such_package/lost.stl"/></geometry></{0}>'
    draft = drafted(biped(sole=SOLE + mesh.format("visual")))
    assert "lost" not in str(draft.notes)
    assert "contact shapes" in {finding.subject for finding in check(draft.settings)}
    lost = link("box", 1.0, more=mesh.format("collision") + mesh.format("visual"))
    draft = drafted(biped(lost, joint("lid", "trunk", "box", at="0 0 0.3")))
    assert said(draft, "contacts", "missing") == "Fill in: shapes of box: the files are missing and were not measured."
    check(draft.settings)


def test_locked_joints_stay_in_their_range(drafted):
    """The nearer limit is written with four digits."""
    limit = 'lower="0.04852" upper="1.5" effort="5" velocity="5"'
    draft = drafted(biped(link("finger", 0.01), joint("knuckle", "trunk", "finger", limit=limit)))
    assert draft.values["robot"]["locked_joints"] == {"knuckle": 0.04852}
    check(draft.settings)


def test_robot_without_mass_is_refused(drafted):
    text = re.sub("<inertial>.*?</inertial>", "", biped())
    assert "the mass of the robot is 0 kg; add <inertial> elements" in refusal(drafted, text)
