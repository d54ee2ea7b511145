"""Checks the structure of a URDF: unique names, one tree of links, known joints, and shapes with sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

from wbc_controller.errors import ConfigurationError, valid_choices

#: Types of joints in a URDF.
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
#: Pinocchio's name of the world, for joints.
_PINOCCHIO_WORLD = "universe"
#: Shapes with the attributes that they require.
SHAPES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("filename",),
}
#: Most names in a message.
_NAMED = 6


def check_structure(tree: ElementTree.Element) -> None:
    """Check names, joints, collision shapes and the tree of links.

    Pinocchio's reader drops what is wrong in silence, or refuses the file without the name of a link or joint.

    Raises:
        ConfigurationError: in one sentence with the link or joint.
    """
    _check_expanded(tree)
    if tree.tag != "robot":
        raise ConfigurationError(f"robot.urdf: its root element is <{tree.tag}>; the one of a URDF is <robot>")
    links, joints = (_unique_names(tree, kind) for kind in ("link", "joint"))
    if not links:
        raise ConfigurationError("robot.urdf: it has no <link>")
    parents: dict[str, str] = {}  # by link, the joint that moves it
    above: dict[str, str] = {}  # by link, the link above it
    for name, joint in joints.items():
        _check_joint(name, joint)
        parent, child = (_end(name, joint, key, links) for key in ("parent", "child"))
        if child in parents:
            raise ConfigurationError(
                f"robot.urdf: link {child!r} is the child of two joints, {parents[child]!r} and {name!r}; a URDF is a "
                "tree: leave one of them out, and close the chain by `loops`"
            )
        parents[child], above[child] = name, parent
    _check_tree(links, above)
    for name, link in links.items():
        for element in link.findall("collision"):
            _check_shape(name, element)


def _check_expanded(tree: ElementTree.Element) -> None:
    """Refuse a file for xacro, whose macros add the links."""
    for element in tree.iter():
        space, _, tag = str(element.tag).rpartition("}")
        if space.rstrip("/").endswith("xacro"):
            raise ConfigurationError(
                f"robot.urdf: it contains <xacro:{tag}>; expand the file with xacro first: xacro FILE > ROBOT.urdf"
            )


def _unique_names(tree: ElementTree.Element, kind: str) -> dict[str, ElementTree.Element]:
    """Return the links or joints by name."""
    found: dict[str, ElementTree.Element] = {}
    for number, element in enumerate(tree.findall(kind), start=1):
        name = element.get("name", "")
        if not name.strip():
            raise ConfigurationError(f"robot.urdf: {kind} number {number} has no name")
        if name in found:
            raise ConfigurationError(f"robot.urdf: two {kind}s are called {name!r}; names of {kind}s are unique")
        found[name] = element
    return found


def _check_joint(name: str, joint: ElementTree.Element) -> None:
    kind = joint.get("type", "")
    if kind not in JOINT_TYPES:
        raise ConfigurationError(
            f"robot.urdf: joint {name!r} has the unknown type {kind!r}; {valid_choices(kind, JOINT_TYPES)}"
        )
    if name == _PINOCCHIO_WORLD:
        raise ConfigurationError(f"robot.urdf: no joint may be called {name!r}, Pinocchio's name of the world")


def _end(name: str, joint: ElementTree.Element, key: str, links: Mapping[str, object]) -> str:
    """Return the link that a joint names as its parent or child."""
    element = joint.find(key)
    link = None if element is None else element.get("link")
    if link is None:
        raise ConfigurationError(f"robot.urdf: joint {name!r} has no <{key} link=…>")
    if link not in links:
        raise ConfigurationError(
            f"robot.urdf: joint {name!r}: its {key} {link!r} is not a link of the URDF; {valid_choices(link, links)}"
        )
    return link


def _check_tree(links: Iterable[str], above: Mapping[str, str]) -> None:
    """Require one root, from which all links can be reached."""
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise ConfigurationError(
            f"robot.urdf: the links {_listed(roots)} have no parent; a URDF is one tree: connect them by joints"
        )
    children: dict[str, list[str]] = {}
    for child, parent in above.items():
        children.setdefault(parent, []).append(child)
    reached, queue = set(roots), list(roots)
    while queue:
        queue = [child for name in queue for child in children.get(name, ())]
        reached.update(queue)
    circle = [name for name in links if name not in reached]
    if circle:
        raise ConfigurationError(
            f"robot.urdf: the links {_listed(circle)} are below each other in a circle; a URDF is a tree: leave one "
            "joint out, and close the chain by `loops`"
        )


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(map(repr, names[:_NAMED])) + more


def _check_shape(link: str, element: ElementTree.Element) -> None:
    if (problem := shape_problem(element)) is not None:
        raise ConfigurationError(f"robot.urdf: link {link!r}: its <{element.tag}> {problem}")


def shape_problem(element: ElementTree.Element) -> str | None:
    """Problem of a ``<collision>`` or ``<visual>``, for which Pinocchio's reader drops the link's other shapes too."""
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
            return f"has a <{shape.tag} {key}={shape.get(key)!r}>; sizes are not negative"
    return None
