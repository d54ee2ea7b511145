"""URDFs that other readers accept silently, or crash on: one sentence each, with link and value."""

import itertools

import pytest
from chains import joint, link, robot
from refusals import refusal
from urdf_models import build_model

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF, parse_urdf, parse_xml

INERTIA = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'


def two(mass: str = "1.0", inertia: str = INERTIA, more: str = "", limit: str = "") -> str:
    """Return a fixed link and a rotating link with a given inertial element."""
    limit = limit or '<limit lower="-1" upper="1" effort="10" velocity="2"/>'
    return f"""<robot name="two"><link name="base"><inertial><mass value="1"/>{INERTIA}</inertial></link>
      <link name="arm"><inertial><mass value="{mass}"/>{inertia}</inertial>{more}</link>
      <joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>{limit}</joint>
      </robot>"""


@pytest.mark.parametrize("mass", ["abc", "1,5", "nan", "inf", "1e400", "", "0x10", "1_0", "1 2", "١"])
def test_non_finite_mass_is_refused(mass):
    said = refusal(build_model, two(mass), ["elbow"], [0.0])
    assert said == f"robot.urdf: link 'arm': <mass value={mass!r}> is not a number, such as 0.5, at most 1e+20"


@pytest.mark.parametrize(
    ("urdf", "said"),
    [
        (two("-1"), "link 'arm': the mass is -1 kg; it must not be negative"),
        (two(inertia=INERTIA.replace('ixx="0.1"', 'ixx="nan"')), "link 'arm': <inertia ixx='nan'> is not a number"),
        (
            two(inertia=INERTIA.replace('ixx="0.1"', 'ixx="-1"')),
            "link 'arm': the smallest principal moment of inertia is -1 kg·m²; it must not be negative",
        ),
        (
            two(inertia=INERTIA.replace('ixy="0"', 'ixy="0.3"')),
            "link 'arm': the smallest principal moment of inertia is -0.2 kg·m²",
        ),
        (two(inertia=INERTIA.replace('ixx="0.1"', "")), "link 'arm': <inertial> has no <inertia ixx=…>"),
        (two().replace('<mass value="1.0"/>', ""), "link 'arm': <inertial> has no <mass value=…>; a massless link"),
        (two("0").replace('"1"/>', '"0.0"/>'), "the mass of the moving links is 0 kg; the minimum is 1e-06 kg"),
        (two().replace("0 1 0", "0 -0.0 0"), "joint 'elbow': <axis xyz='0 -0.0 0'> has zero length; example: '0 0 1'"),
        (two(more='<collision><origin xyz="0 0"/></collision>'), "link 'arm': <origin xyz='0 0'> is not 3 numb"),
        (
            two(more='<collision><geometry><box size="1 1 nan"/></geometry></collision>'),
            "<box size='1 1 nan'> is not 3",
        ),
        (two(limit='<limit lower="0" upper="1" effort="1,5" velocity="2"/>'), "joint 'elbow': <limit effort='1,5'> is"),
        (two(limit='<limit lower="-1" upper="1" effort="9" velocity="nan"/>'), "joint 'elbow': <limit velocity='nan'>"),
        (two().replace("0 1 0", "0 ${up} 0"), "joint 'elbow': <axis xyz='0 ${up} 0'> is not 3 numbers"),
        ('<!DOCTYPE robot [<!ENTITY m "1.0">]>' + two("&m;"), "not a usable URDF: <!DOCTYPE> is not supported"),
        (two().replace(">", ">" + " " * LARGEST_URDF, 1), "characters; the maximum is 4000000"),
        (two().replace("</robot>", ""), "not a usable URDF: no element found"),
        ("\ud800", "not a usable URDF: "),
        (two("1\0"), "not a usable URDF: not well-formed"),
    ],
)
def test_invalid_urdfs_are_refused_in_one_sentence(urdf, said):
    sentence = refusal(build_model, urdf, ["elbow"], [0.0])
    assert sentence.startswith("robot.urdf: ")
    assert said in sentence
    assert len(sentence.splitlines()) == 1
    assert len(sentence) < 400


def test_massless_links():
    with pytest.raises(ConfigurationError, match="the mass of the moving links is 0 kg"):
        build_model(two("0", INERTIA.replace("0.1", "0")), ["elbow"], [0.0], floating_base=False)
    build_model(two("0", INERTIA.replace("0.1", "0")), ["elbow"], [0.0])
    build_model(two(inertia=INERTIA.replace('ixx="0.1"', 'ixx="-1e-9"')), ["elbow"], [0.0])
    frame = '<link name="tip"/><joint name="fix" type="fixed"><parent link="arm"/><child link="tip"/></joint></robot>'
    model = build_model(two().replace("</robot>", frame), ["elbow"], [0.0])
    assert model.pinocchio.existFrame("tip")


def chain(links: int) -> str:
    names = [f"l{i}" for i in range(links)]
    joints = [joint(f"j{i}", a, b) for i, (a, b) in enumerate(itertools.pairwise(names))]
    return robot(*map(link, names), *joints)


def test_longest_chain():
    assert build_model(chain(1000), ["j0"], [0.0], floating_base=False).joints == ("j0",)
    with pytest.raises(ConfigurationError, match="'l1000' is number 1001 in a chain of links; the maximum is 1000"):
        parse_urdf(chain(1001))
    star = [joint(f"j{i}", "l0", f"l{i}") for i in range(1, 5001)]
    with pytest.raises(ConfigurationError, match="the number of links is 5001; the maximum is 5000"):
        parse_urdf(robot(*(link(f"l{i}") for i in range(5001)), *star))


def test_srdf_entities_are_refused():
    said = refusal(parse_xml, '<!DOCTYPE r [<!ENTITY x "y">]><r>&x;</r>', "limits.self_collision.srdf", "SRDF")
    assert said.startswith("limits.self_collision.srdf: not a usable SRDF: <!DOCTYPE> is not supported")
