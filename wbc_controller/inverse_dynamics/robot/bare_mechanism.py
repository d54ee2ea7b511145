"""Mechanism of a URDF for Pinocchio and MuJoCo."""

import copy
from collections.abc import Collection, Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.urdf_structure import vector_of

#: Elements outside the mechanism: shapes, joint friction, and <mimic>, which `Followers` handles.
_DROPPED = {"link": ("visual", "collision"), "joint": ("dynamics", "mimic", "safety_controller", "calibration")}


def bare_mechanism(
    tree: ElementTree.Element, moving: Collection[str], locked: Mapping[str, float]
) -> ElementTree.Element:
    """Copy a URDF without shapes and extensions; fix joints outside `moving` at locked positions, rad or m."""
    bare = ElementTree.Element(tree.tag, tree.attrib)
    for element in tree:
        if element.tag not in _DROPPED:
            continue
        part = copy.deepcopy(element)
        for tag in _DROPPED[element.tag]:
            for other in part.findall(tag):
                part.remove(other)
        name = str(part.get("name"))
        if part.tag == "joint" and name not in moving:
            _lock(part, locked.get(name, 0.0))
        bare.append(part)
    return bare


def shapes_only(urdf: str, kind: str) -> str:
    """Return a URDF with fixed joints and the shapes of one kind, ``collision`` or ``visual``.

    ``<collision_checking>`` marks cylinders that Pinocchio reads as capsules.
    """
    tree = ElementTree.fromstring(urdf)  # noqa: S314 - checked
    for link in tree.findall("link"):
        for element in [element for element in link if element.tag not in (kind, f"{kind}_checking")]:
            link.remove(element)
    for joint in tree.findall("joint"):
        _lock(joint, 0.0)
    for element in [element for element in tree if element.tag not in (*_DROPPED, "material")]:
        tree.remove(element)
    return ElementTree.tostring(tree, encoding="unicode")


def _lock(joint: ElementTree.Element, position: float) -> None:
    if position != 0.0:
        origin = joint.find("origin")
        if origin is None:
            origin = ElementTree.SubElement(joint, "origin")
        xyz, rpy = (vector_of(origin, key, "0 0 0") for key in ("xyz", "rpy"))
        axis = vector_of(joint.find("axis"), "xyz", "1 0 0")
        along = position * axis / np.linalg.norm(axis)
        motion = (
            pin.SE3(np.eye(3), along) if joint.get("type") == "prismatic" else pin.SE3(pin.exp3(along), np.zeros(3))
        )
        placement = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz) * motion
        origin.set("xyz", " ".join(map(repr, placement.translation.tolist())))
        origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(placement.rotation).tolist())))
    for element in [element for element in joint if element.tag not in ("parent", "child", "origin")]:
        joint.remove(element)
    joint.set("type", "fixed")
