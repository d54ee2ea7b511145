"""URDF reader for untrusted text, without Pinocchio.

All functions raise `ConfigurationError` in one sentence. Other readers ignore invalid content, or crash.
"""

import re
from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.urdf_structure import check_structure, end_of, shape_problem, vector_of
from wbc_controller.records import Array
from wbc_controller.settings.robot import JointLimitSettings

UNLIMITED = 1.0e6  # rad: out of reach, with a rounding error of 1e-10 rad
LARGEST_URDF = 4_000_000  # characters
_ROUNDING = 1.0e-6  # of moments of inertia, kg·m²
_LARGEST_NUMBER = 1.0e20
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMPONENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
#: Numeric attributes of each element, with their number of values.
_NUMBERS: dict[str, dict[str, int]] = {
    "mass": {"value": 1},
    "inertia": dict.fromkeys(_COMPONENTS, 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}


class _Builder(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("<!DOCTYPE> is not supported; replace its entities by their content")


def parse_xml(text: str, key: str, kind: str) -> ElementTree.Element:
    """Parse a URDF or SRDF; `key` (configuration) and `kind` are for the error."""
    try:
        if len(text) > LARGEST_URDF:
            raise ValueError(f"it has {len(text)} characters; the maximum is {LARGEST_URDF}")
        parser = ElementTree.XMLParser(target=_Builder())  # noqa: S314 - it refuses entities
        return ElementTree.fromstring(text, parser)  # noqa: S314
    except (ElementTree.ParseError, ValueError) as error:
        raise ConfigurationError(f"{key}: not a usable {kind}: {error}") from error


def parse_urdf(urdf: str) -> ElementTree.Element:
    """Read and check a URDF.

    Refuses invalid XML, numbers, joint axes and inertias, too many links, and invalid structures (`check_structure`).
    """
    tree = parse_xml(urdf, "robot.urdf", "URDF")
    for body in (*tree.findall("link"), *tree.findall("joint")):
        subject = f"robot.urdf: {body.tag} {body.get('name')!r}"
        for element in body.iter():
            for key, count in _NUMBERS.get(element.tag, {}).items():
                if (text := element.get(key)) is not None:
                    _require_numbers(text, count, f"{subject}: <{element.tag} {key}=")
        axis = body.find("axis")
        if axis is not None and body.get("type") != "fixed" and not vector_of(axis, "xyz", "1 0 0").any():
            raise ConfigurationError(f"{subject}: <axis xyz={axis.get('xyz')!r}> has zero length; example: '0 0 1'")
        _check_inertial(body, subject)
    check_structure(tree)
    return tree


def read_robot(urdf: str, limits: Mapping[str, JointLimitSettings]) -> tuple[ElementTree.Element, str]:
    """Read and check a URDF, replace limits of joints, and split joints with several coordinates.

    A continuous joint becomes a revolute joint without position limits: Pinocchio would lose its turns. A planar joint
    becomes MoveIt's joints ``NAME/x`` and ``NAME/y`` in its plane, and ``NAME/theta``. Missing limits are refused.
    Returns the tree, and its text for other readers.
    """
    tree = parse_urdf(urdf)
    changed = _drop_unusable_visuals(tree)
    changed |= split_planar_joints(tree)
    joints = {str(joint.get("name")): joint for joint in tree.findall("joint")}
    require_known(limits, joints, "robot.joint_limits:", " is not a joint of the URDF")
    for name, joint in joints.items():
        given = limits[name].model_dump(exclude_none=True) if name in limits else {}
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            given = {"lower": -UNLIMITED, "upper": UNLIMITED} | given
        if given:
            _write_limits(joint, given)
            changed = True
        if joint.get("type") in ("revolute", "prismatic"):
            _require_limits(name, joint.find("limit"))
    return tree, ElementTree.tostring(tree, encoding="unicode") if changed else urdf


def split_planar_joints(tree: ElementTree.Element) -> bool:
    """Replace planar joints by joints with one coordinate, in place; return True if there are any."""
    planar = [joint for joint in tree.findall("joint") if joint.get("type") == "planar"]
    for joint in planar:
        _split(tree, joint)
    return bool(planar)


def _split(tree: ElementTree.Element, planar: ElementTree.Element) -> None:
    name, normal = str(planar.get("name")), vector_of(planar.find("axis"), "xyz", "1 0 0")
    normal /= np.linalg.norm(normal)
    across = np.cross([0.0, 1.0, 0.0], normal)  # x if the normal is z
    if not (np.linalg.norm(across) > 0.1):
        across = np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    links = [f"{name}/x_link", f"{name}/y_link", end_of(planar, "child")]
    axes = {"x": across, "y": np.cross(normal, across), "theta": normal}
    place, before = list(tree).index(planar), end_of(planar, "parent")
    origin, limit = planar.find("origin"), planar.find("limit")
    tree.remove(planar)
    for i, ((part, direction), after) in enumerate(zip(axes.items(), links, strict=True)):
        joint = ElementTree.Element("joint", name=f"{name}/{part}", type="revolute" if part == "theta" else "prismatic")
        ElementTree.SubElement(joint, "parent", link=before)
        ElementTree.SubElement(joint, "child", link=after)
        if origin is not None and i == 0:
            joint.append(origin)
        ElementTree.SubElement(joint, "axis", xyz=" ".join(map(repr, direction.tolist())))
        # A planar joint needs no limits, and 0 counts as missing.
        ElementTree.SubElement(
            joint, "limit", {"effort": "0", "velocity": "0"} | ({} if limit is None else limit.attrib)
        )
        _write_limits(joint, {"lower": -UNLIMITED, "upper": UNLIMITED})
        tree.insert(place + i, joint)
        before = after
    for link in links[:2]:
        ElementTree.SubElement(tree, "link", name=link)


def _write_limits(joint: ElementTree.Element, values: Mapping[str, float]) -> None:
    element = joint.find("limit")
    if element is None:
        element = ElementTree.SubElement(joint, "limit")
    for key, value in values.items():
        element.set(key, repr(value))


def _require_limits(name: str, limit: ElementTree.Element | None) -> None:
    given = {} if limit is None else limit.attrib
    for key in ("effort", "velocity"):
        if key not in given:
            raise ConfigurationError(
                f"robot.urdf: joint {name!r}: it has no <limit {key}=…>; add it, or set robot.joint_limits.{name}.{key}"
            )
    lower, upper = (float(given.get(key, "0")) for key in ("lower", "upper"))
    if not (lower <= upper):
        raise ConfigurationError(
            f"robot.urdf: joint {name!r}: the lower limit {lower:g} is above the upper limit {upper:g}; correct the "
            f"URDF, or set lower and upper of robot.joint_limits.{name}"
        )


def _drop_unusable_visuals(tree: ElementTree.Element) -> bool:
    known: set[str | None] = set()
    unusable = []
    for material in tree.findall("material"):
        name = material.get("name")
        if not name or name in known:
            unusable.append((tree, material))
        known.add(name)
    for link in tree.findall("link"):
        for visual in link.findall("visual"):
            if shape_problem(visual) is not None:
                unusable.append((link, visual))
            unusable += [(visual, material) for material in visual.findall("material") if not material.get("name")]
    for parent, element in unusable:
        parent.remove(element)
    return bool(unusable)


def inertia_tensor(inertia: ElementTree.Element) -> Array:
    """Return the tensor of a URDF's ``<inertia>``, (3, 3) in kg·m²."""
    tensor = np.zeros((3, 3))
    for key in _COMPONENTS:
        i, j = ("xyz".index(axis) for axis in key[1:])
        tensor[i, j] = tensor[j, i] = float(inertia.get(key, "0"))
    return tensor


def _require_numbers(text: str, count: int, where: str) -> None:
    values = text.split()
    if len(values) != count or not all(
        _NUMBER.fullmatch(value) and abs(float(value)) <= _LARGEST_NUMBER for value in values
    ):
        what = "a number, such as 0.5" if count == 1 else f"{count} numbers, such as '0 0 0.5'"
        hint = "; expand the file with xacro first" if "${" in text or "$(" in text else ""
        shown = text if len(text) <= 80 else text[:80] + "…"
        raise ConfigurationError(f"{where}{shown!r}> is not {what}, at most {_LARGEST_NUMBER:g}{hint}")


def _check_inertial(link: ElementTree.Element, subject: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    for name, keys in (("mass", ("value",)), ("inertia", _COMPONENTS)):
        element = inertial.find(name)
        missing = [key for key in keys if element is None or element.get(key) is None]
        if missing:
            raise ConfigurationError(
                f"{subject}: <inertial> has no <{name} {missing[0]}=…>; a massless link has no <inertial>"
            )
    mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    if not (mass >= 0.0):
        raise ConfigurationError(f"{subject}: the mass is {mass:g} kg; it must not be negative")
    tensor = inertia_tensor(inertial.find("inertia"))  # type: ignore[arg-type]
    smallest = float(np.linalg.eigvalsh(tensor)[0])
    if not (smallest >= -_ROUNDING):
        raise ConfigurationError(
            f"{subject}: the smallest principal moment of inertia is {smallest:g} kg·m²; it must not be negative"
        )
