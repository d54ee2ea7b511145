"""Virtual joints in place of a floating base."""

from xml.etree import ElementTree

import numpy as np

_LEAST_VOLUME = 0.1  # of three unit axes that span the space


def virtual_joints(tree: ElementTree.Element) -> list[str]:
    """Return the virtual joints of a floating base, from the root on.

    These are one floating joint, or three prismatic and three rotational joints, between massless links; fixed joints
    may be between them.
    """
    masses = {str(link.get("name")): _mass(link) for link in tree.findall("link")}
    below: dict[str, list[ElementTree.Element]] = {}
    for joint in tree.findall("joint"):
        below.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for joint in tree.findall("joint")}
    link = next((name for name in masses if name not in children), "")
    names: list[str] = []
    axes: dict[str, list[list[float]]] = {"prismatic": [], "revolute": []}
    while masses.get(link) == 0.0 and len(below.get(link, ())) == 1:
        joint = below[link][0]
        kind, link = str(joint.get("type")), _end(joint, "child")
        names.append(str(joint.get("name")))
        if kind == "floating":
            return names
        if kind != "fixed":
            axis = joint.find("axis")
            direction = [float(part) for part in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()]
            axes.setdefault("revolute" if kind == "continuous" else kind, []).append(direction)
        if len(axes) == 2 and all(len(some) == 3 and _span(some) for some in axes.values()):
            return names
    return []


def drop_virtual_joints(tree: ElementTree.Element) -> bool:
    """Remove virtual joints and the links above the base, in place; return True if there are any."""
    names = virtual_joints(tree)
    joints = [joint for joint in tree.findall("joint") if joint.get("name") in names]
    above = {_end(joint, "parent") for joint in joints}
    for element in [*joints, *(link for link in tree.findall("link") if link.get("name") in above)]:
        tree.remove(element)
    return bool(names)


def _end(joint: ElementTree.Element, key: str) -> str:
    element = joint.find(key)
    return "" if element is None else str(element.get("link"))


def _mass(link: ElementTree.Element) -> float:
    mass = link.find("inertial/mass")
    return 0.0 if mass is None else float(mass.get("value", "0"))


def _span(axes: list[list[float]]) -> bool:
    unit = np.array(axes) / np.linalg.norm(axes, axis=1, keepdims=True)
    return bool(abs(np.linalg.det(unit)) > _LEAST_VOLUME)
