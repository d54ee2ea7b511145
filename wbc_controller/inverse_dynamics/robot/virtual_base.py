"""Virtual joints in place of a floating base."""

from xml.etree import ElementTree

import numpy as np

from wbc_controller.inverse_dynamics.robot.urdf_structure import end_of, mass_of, vector_of
from wbc_controller.records import Array

_LEAST_VOLUME = 0.1  # of three unit axes that span the space


def virtual_joints(tree: ElementTree.Element) -> list[str]:
    """Return the virtual joints of a floating base, from the root on.

    These are one floating joint, or three prismatic and three rotational joints, between massless links; fixed joints
    may be between them.
    """
    masses = {str(link.get("name")): mass_of(link) for link in tree.findall("link")}
    below: dict[str, list[ElementTree.Element]] = {}
    for joint in tree.findall("joint"):
        below.setdefault(end_of(joint, "parent"), []).append(joint)
    children = {end_of(joint, "child") for joint in tree.findall("joint")}
    link = next((name for name in masses if name not in children), "")
    names: list[str] = []
    axes: dict[str, list[Array]] = {"prismatic": [], "revolute": []}
    while masses.get(link) == 0.0 and len(below.get(link, ())) == 1:
        joint = below[link][0]
        kind, link = str(joint.get("type")), end_of(joint, "child")
        names.append(str(joint.get("name")))
        if kind == "floating":
            return names
        if kind != "fixed":
            direction = vector_of(joint.find("axis"), "xyz", "1 0 0")
            axes.setdefault("revolute" if kind == "continuous" else kind, []).append(direction)
        if len(axes) == 2 and all(len(some) == 3 and _span(some) for some in axes.values()):
            return names
    return []


def drop_virtual_joints(tree: ElementTree.Element) -> bool:
    """Remove virtual joints and the links above the base, in place; return True if there are any."""
    names = virtual_joints(tree)
    joints = [joint for joint in tree.findall("joint") if joint.get("name") in names]
    above = {end_of(joint, "parent") for joint in joints}
    for element in [*joints, *(link for link in tree.findall("link") if link.get("name") in above)]:
        tree.remove(element)
    return bool(names)


def _span(axes: list[Array]) -> bool:
    unit = np.array(axes) / np.linalg.norm(axes, axis=1, keepdims=True)
    return bool(abs(np.linalg.det(unit)) > _LEAST_VOLUME)
