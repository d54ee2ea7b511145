"""Robots written as text with one property each that other readers of URDFs drop, refuse or misread."""

MASS = '<inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial>'  # noqa: E501
BOX = '<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'
SOLE = BOX.format(at="0.03 0 -0.03", size="0.2 0.1 0.03")
TRUNK = BOX.format(at="0 0 0.1", size="0.15 0.25 0.3")
#: An outline of a sole with a corner 20 µm beyond an edge, as an ``.obj`` file.
EDGED_SOLE = (
    "".join(
        f"v {x} {y} {z}\n"
        for z in (-0.045, -0.015)
        for x, y in ((-0.1, -0.045), (0.0, -0.04502), (0.1, -0.045), (0.068, 0.045), (-0.1, 0.045))
    )
    + "f 5 4 3 2 1\nf 6 7 8 9 10\nf 1 2 7 6\nf 2 3 8 7\nf 3 4 9 8\nf 4 5 10 9\nf 5 1 6 10\n"
)


def link(name: str, mass: float = 0.0, at: str = "0 0 0", inertia: float | None = None, more: str = "") -> str:
    inertial = MASS.format(at=at, mass=mass, i=0.01 * mass if inertia is None else inertia) if mass else ""
    return f'<link name="{name}">{inertial}{more}</link>\n'


def joint(name: str, parent: str, child: str, axis: str = "0 1 0", at: str = "0 0 0", *, kind: str = "revolute",
          limit: str = 'lower="-2" upper="2" effort="100" velocity="10"', more: str = "") -> str:  # fmt: skip
    limit = f"<limit {limit}/>" if limit else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        f'<axis xyz="{axis}"/>{limit}{more}</joint>\n'
    )


def robot(*parts: str) -> str:
    return f'<robot name="case">\n{"".join(parts)}</robot>\n'


def leg(side: str, hip: str = "trunk", sole: str = SOLE, ankle: str = "ankle_pitch") -> str:
    """A leg of five joints; `ankle` is the name of its ankle's pitch."""
    limits = 'lower="{}" upper="{}" effort="100" velocity="10"'
    y = 0.1 if side == "left" else -0.1
    return "".join((
        link(f"{side}_hip", 1.0), link(f"{side}_thigh", 3.0, "0 0 -0.15"), link(f"{side}_shank", 2.0, "0 0 -0.15"),
        link(f"{side}_ankle", 0.3), link(f"{side}_foot", 1.0, "0.03 0 -0.03", more=sole),
        joint(f"{side}_hip_roll", hip, f"{side}_hip", "1 0 0", f"0 {y} -0.1", limit=limits.format(-0.5, 0.5)),
        joint(f"{side}_hip_pitch", f"{side}_hip", f"{side}_thigh"),
        joint(f"{side}_knee", f"{side}_thigh", f"{side}_shank", at="0 0 -0.3", limit=limits.format(0.0, 2.2)),
        joint(f"{side}_{ankle}", f"{side}_shank", f"{side}_ankle", at="0 0 -0.3", limit=limits.format(-1, 1)),
        joint(f"{side}_ankle_roll", f"{side}_ankle", f"{side}_foot", "1 0 0", limit=limits.format(-0.5, 0.5)),
    ))  # fmt: skip


def biped(*more: str, hip: str = "trunk", sole: str = SOLE, ankle: str = "ankle_pitch") -> str:
    legs = (leg(side, hip, sole, ankle) for side in ("left", "right"))
    return robot(*more, link("trunk", 10.0, "0 0 0.1", more=TRUNK), *legs)


def arm(*more: str, first: str = "", second: str = "") -> str:
    """An arm of three joints, the first and second of which can be given."""
    limit = 'lower="-2" upper="2" effort="50" velocity="5"'
    return robot(
        link("base"), *(link(f"l{number}", 2.0, "0 0 0.15") for number in (1, 2, 3)),
        first or joint("j1", "base", "l1", "0 0 1", "0 0 0.3", limit=limit),
        second or joint("j2", "l1", "l2", at="0 0 0.3", limit=limit),
        joint("j3", "l2", "l3", at="0 0 0.3", limit=limit), *more,
    )  # fmt: skip


def _finger(name: str, below: str, limit: str, *, kind: str, axis: str, more: str = "") -> str:
    return joint(name, "l3", below, axis, "0 0 0.3", kind=kind, limit=limit, more=more)


#: Fingers of 100 g: one range of 40 mm, the second follows; and two that turn without end.
FINGERS = "".join(link(f"f{number}", 0.1, "0 0 0.02", 1.0e-5) for number in (1, 2))
SLIDING = FINGERS + "".join((
    _finger("a_g2", "f2", 'lower="0" upper="0.04" effort="5" velocity="0.2"', kind="prismatic", axis="0 1 0",
            more='<mimic joint="g1"/>'),
    _finger("g1", "f1", 'lower="0" upper="0.04" effort="5" velocity="0.2"', kind="prismatic", axis="0 -1 0"),
))  # fmt: skip
TURNING = FINGERS + "".join((
    _finger("g1", "f1", 'effort="5" velocity="2"', kind="continuous", axis="0 1 0"),
    _finger("g2", "f2", 'effort="5" velocity="2"', kind="continuous", axis="0 1 0",
            more='<mimic joint="g1" multiplier="-1"/>'),
))  # fmt: skip
WAIST = link("pelvis", 3.0) + joint(
    "waist", "trunk", "pelvis", "0 0 1", "0 0 -0.05", limit='lower="-1.5" upper="1.5" effort="100" velocity="10"'
)
FLOATING = link("world") + joint("floating_base_joint", "world", "trunk", kind="floating", limit="")
_SIX = (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"), ("yaw", "0 0 1"), ("pitch", "0 1 0"), ("roll", "1 0 0"))
VIRTUAL = link("map") + "".join(
    (link(f"v{i}") if i < 5 else "") + joint(
        name, f"v{i - 1}" if i else "map", f"v{i}" if i < 5 else "trunk", axis,
        kind="prismatic" if i < 3 else "continuous",
        limit='lower="-1000" upper="1000" effort="1000" velocity="1000"' if i < 3 else "",
    )
    for i, (name, axis) in enumerate(_SIX)
)  # fmt: skip
POINTS = "".join(
    f'<collision><origin xyz="{x} {y} -0.045"/><geometry><sphere radius="0.0"/></geometry></collision>'
    for x in (-0.07, 0.13) for y in (-0.05, 0.05)
)  # fmt: skip
#: A visual for which other readers drop the shapes of its link.
UNNAMED = '<visual><geometry><box size="1 1 1"/></geometry><material><color rgba="0 0 0 1"/></material></visual>'
#: A light link, to be locked, below a link that has the name of a joint.
TIP = link("tip", 0.01) + joint("tip_joint", "left_ankle", "tip", at="0.05 0 0")
#: An ankle whose range allows a squat of 20 mm.
STIFF = ('lower="-1" upper="1"', 'lower="-0.45" upper="1"')


def rover() -> str:
    """A quadruped of 10 kg on wheels with a tread of 50 mm."""
    wheel = '<geometry><cylinder radius="0.08" length="0.05"/></geometry>'
    tread = f'<collision><origin rpy="1.5707963 0 0"/>{wheel}</collision>'
    parts = [link("body", 6.0, inertia=0.1, more=BOX.format(at="0 0 0", size="0.5 0.2 0.1"))]
    for name, x, y in (("fl", 0.25, 0.15), ("fr", 0.25, -0.15), ("rl", -0.25, 0.15), ("rr", -0.25, -0.15)):
        parts += [
            link(f"{name}_hip", 0.2), joint(f"{name}_abduction", "body", f"{name}_hip", "1 0 0", f"{x} {y} 0"),
            link(f"{name}_thigh", 0.4, "0 0 -0.1"), joint(f"{name}_pitch", f"{name}_hip", f"{name}_thigh"),
            link(f"{name}_shank", 0.2, "0 0 -0.1"),
            joint(f"{name}_knee", f"{name}_thigh", f"{name}_shank", at="0 0 -0.2",
                  limit='lower="-2.6" upper="-0.2" effort="40" velocity="10"'),
            link(f"{name}_wheel", 0.4, inertia=0.001, more=tread),
            joint(f"{name}_spin", f"{name}_shank", f"{name}_wheel", at="0 0 -0.2", kind="continuous",
                  limit='effort="20" velocity="20"'),
        ]  # fmt: skip
    return robot(*parts)


#: Robots that stand, or arms that hold still, with everything that `wbc new` writes.
STANDING = {
    "a link and a joint of one name": biped(TIP, ankle="ankle"),
    "a planar joint without limits": arm(
        first=joint("j1", "base", "l1", "0 0 1", "0 0 0.3", kind="planar", limit="")
    ),
    "a world link with a floating joint": biped(FLOATING),
    "a sole with a corner on an edge": biped(
        sole='<collision><geometry><mesh filename="sole.obj"/></geometry></collision>'
    ),
    "legs below a waist": biped(WAIST, hip="pelvis"),
    "six virtual joints": biped(VIRTUAL),
    "fingers that slide": arm(SLIDING),
    "points at the corners of the soles": biped(sole=SOLE + POINTS),
    "fingers that turn": arm(TURNING),
    "ankles with a small range": biped().replace(*STIFF),
    "legs on wheels": rover(),
}  # fmt: skip
XACRO = (
    '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm"><xacro:include filename="arm.xacro"/>'
    '<link name="world"/><xacro:arm prefix="" parent="world"/></robot>'
)
#: URDFs that are refused, with words of the message.
REFUSED = {
    "a link with two parents": (
        arm(joint("j4", "base", "l3", at="0.2 0 0")),
        "link 'l3' is the child of two joints, 'j3' and 'j4'; a URDF is a tree: remove one of them, and close the "
        "chain with `loops`",
    ),
    "exchanged limits": (
        arm(second=joint("j2", "l1", "l2", limit='lower="2" upper="-2" effort="50" velocity="5"')),
        "joint 'j2': the lower limit 2 is above the upper limit -2",
    ),
    "a file for xacro": (XACRO, "it contains <xacro:include>; expand the file with xacro first"),
    "two links of one name": (arm(link("l2")), "duplicate link 'l2'; link names must be unique"),
    "two joints of one name": (arm(link("l4"), joint("j2", "l3", "l4")), "duplicate joint 'j2'"),
    "a link without a name": (arm(link("")), "link number 5 has no name"),
    "an unknown type": (arm(link("l4"), joint("j4", "l3", "l4", kind="hinge")), "joint 'j4' has the unknown type 'hi"),
    "an unknown parent": (arm(joint("j4", "l9", "l3")), "joint 'j4': its parent 'l9' is not a link of the URDF"),
    "no child": (arm('<joint name="j4" type="fixed"><parent link="l3"/></joint>'), "'j4' has no <child link=…>"),
    "two roots": (arm(link("l4")), "the links 'base', 'l4' have no parent; a URDF is one tree"),
    "a circle": (arm(link("a"), link("b"), joint("j4", "a", "b"), joint("j5", "b", "a")), "'a', 'b' form a cycle"),
    "another format": ("<sdf version='1.6'/>", "the root element is <sdf>; expected <robot>"),
    "no links": ("<robot name='none'/>", "no <link> found"),
    "a name of Pinocchio": (arm(link("l4"), joint("universe", "l3", "l4")), "invalid joint name 'universe'"),
    "a shape without a size": (
        biped(sole="<collision><geometry><cylinder radius='0.1'/></geometry></collision>"),
        "link 'left_foot': its <collision> has a <cylinder> without length",
    ),
    "an unknown shape": (
        biped(sole="<collision><geometry><plane/></geometry></collision>"),
        "link 'left_foot': its <collision> has the unknown shape <plane>",
    ),
    "a negative size": (
        biped(sole="<collision><geometry><sphere radius='-0.1'/></geometry></collision>"),
        "link 'left_foot': its <collision> has a <sphere radius='-0.1'>; sizes must not be negative",
    ),
}
