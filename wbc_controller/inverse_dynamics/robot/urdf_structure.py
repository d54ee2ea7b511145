"""Structure of a URDF: access and checks."""

from collections.abc import Collection, Mapping
from xml.etree import ElementTree

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known, valid_choices
from wbc_controller.records import Array

LONGEST_CHAIN, MOST_LINKS = 1000, 5000  # for Pinocchio's recursion and run time
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_PINOCCHIO_WORLD = "universe"
#: Shapes with required attributes.
SHAPES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("filename",),
}
_NAMED = 6  # in a message


def vector_of(element: ElementTree.Element | None, key: str, default: str) -> Array:
    """Return the numbers of an attribute of a checked URDF."""
    text = default if element is None else element.get(key, default)
    return np.array([float(part) for part in text.split()])


def mass_of(link: ElementTree.Element) -> float:
    """Return the mass of a link of a checked URDF, kg."""
    return float(vector_of(link.find("inertial/mass"), "value", "0")[0])


def end_of(joint: ElementTree.Element, key: str) -> str:
    """Return the link of a joint's ``parent`` or ``child``, or ""."""
    element = joint.find(key)
    return "" if element is None else str(element.get("link"))


def check_structure(tree: ElementTree.Element) -> None:
    """Check names, joints, collision shapes and the tree of links.

    Pinocchio drops invalid parts silently.
    """
    for element in tree.iter():
        space, _, tag = str(element.tag).rpartition("}")
        if space.rstrip("/").endswith("xacro"):
            raise ConfigurationError(
                f"robot.urdf: it contains <xacro:{tag}>; expand the file with xacro first: xacro FILE > ROBOT.urdf"
            )
    if tree.tag != "robot":
        raise ConfigurationError(f"robot.urdf: the root element is <{tree.tag}>; expected <robot>")
    links, joints = (_unique_names(tree, kind) for kind in ("link", "joint"))
    if not links:
        raise ConfigurationError("robot.urdf: no <link> found")
    parents: dict[str, str] = {}  # joint above each link
    above: dict[str, str] = {}  # parent of each link
    for name, joint in joints.items():
        require_known(joint.get("type", ""), JOINT_TYPES, f"robot.urdf: joint {name!r} has the unknown type")
        if name == _PINOCCHIO_WORLD:
            raise ConfigurationError(f"robot.urdf: invalid joint name {name!r}: Pinocchio reserves it for the world")
        parent, child = (_end(name, joint, key, links) for key in ("parent", "child"))
        if child in parents:
            raise ConfigurationError(
                f"robot.urdf: link {child!r} is the child of two joints, {parents[child]!r} and {name!r}; a URDF is a "
                "tree: remove one of them, and close the chain with `loops`"
            )
        parents[child], above[child] = name, parent
    _check_tree(links, above)
    for name, link in links.items():
        for element in link.findall("collision"):
            if (problem := shape_problem(element)) is not None:
                raise ConfigurationError(f"robot.urdf: link {name!r}: its <{element.tag}> {problem}")


def _unique_names(tree: ElementTree.Element, kind: str) -> dict[str, ElementTree.Element]:
    found: dict[str, ElementTree.Element] = {}
    for number, element in enumerate(tree.findall(kind), start=1):
        name = element.get("name", "")
        if not name.strip():
            raise ConfigurationError(f"robot.urdf: {kind} number {number} has no name")
        if name in found:
            raise ConfigurationError(f"robot.urdf: duplicate {kind} {name!r}; {kind} names must be unique")
        found[name] = element
    return found


def _end(name: str, joint: ElementTree.Element, key: str, links: Mapping[str, object]) -> str:
    element = joint.find(key)
    link = None if element is None else element.get("link")
    if link is None:
        raise ConfigurationError(f"robot.urdf: joint {name!r} has no <{key} link=…>")
    require_known(link, links, f"robot.urdf: joint {name!r}: its {key}", " is not a link of the URDF")
    return link


def _check_tree(links: Collection[str], above: Mapping[str, str]) -> None:
    if len(links) > MOST_LINKS:
        raise ConfigurationError(f"robot.urdf: the number of links is {len(links)}; the maximum is {MOST_LINKS}")
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise ConfigurationError(
            f"robot.urdf: the links {_listed(roots)} have no parent; a URDF is one tree: connect them by joints"
        )
    children: dict[str, list[str]] = {}
    for child, parent in above.items():
        children.setdefault(parent, []).append(child)
    reached, level, depth = set(roots), roots, 1
    while level := [child for name in level for child in children.get(name, ())]:
        depth += 1
        if depth > LONGEST_CHAIN:
            raise ConfigurationError(
                f"robot.urdf: link {level[0]!r} is number {depth} in a chain of links; the maximum is {LONGEST_CHAIN}"
            )
        reached.update(level)
    circle = [name for name in links if name not in reached]
    if circle:
        raise ConfigurationError(
            f"robot.urdf: the links {_listed(circle)} form a cycle; a URDF is a tree: remove one joint, and close the "
            "chain with `loops`"
        )


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(map(repr, names[:_NAMED])) + more


def shape_problem(element: ElementTree.Element) -> str | None:
    """Return the problem of a ``<collision>`` or ``<visual>``."""
    geometry = element.find("geometry")
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        return "has no <geometry> with a shape; " + valid_choices("", SHAPES)
    if shape.tag not in SHAPES:
        return f"has the unknown shape <{shape.tag}>; {valid_choices(str(shape.tag), SHAPES)}"
    for key in SHAPES[shape.tag]:
        if shape.get(key) is None:
            return f"has a <{shape.tag}> without {key}"
        if key != "filename" and any(float(value) < 0.0 for value in shape.get(key, "").split()):
            return f"has a <{shape.tag} {key}={shape.get(key)!r}>; sizes must not be negative"
    return None
