"""Steps from a URDF to a draft."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new import tuning
from wbc_controller.apps.new.feet import LEG_JOINTS, Body
from wbc_controller.apps.new.foot_shape import Foot, links_of
from wbc_controller.apps.new.mechanism import UrdfSource, choose_joints, ranges_of, read_postures, read_source
from wbc_controller.apps.new.notes import Draft, Origin
from wbc_controller.apps.new.posture import Postures, put_fixed, put_standing, srdf_posture
from wbc_controller.apps.new.standing_posture import Legs
from wbc_controller.controller.build.collision_elements import read_collision_elements
from wbc_controller.controller.build.collision_model import with_visuals
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.virtual_base import virtual_joints
from wbc_controller.settings.files import parse_settings
from wbc_controller.settings.resources import PACKAGE_SCHEME, locate

Base = Literal["floating", "fixed"]
#: First line of the file, a comment.
TITLE = "Drafted by `wbc new`. Every key, its unit, range and default: docs/configuration.md."
_WORLD = "world"  # root link of a fixed robot


def new_configuration(
    urdf: str, *, srdf: str | None = None, base: Base | None = None, feet: Sequence[str] = ()
) -> Draft:
    """Return the draft of a configuration; `urdf` and `srdf` are paths or ``package://`` addresses.

    Without the type of the base or the links of the feet, they are found in the files.

    Raises `ConfigurationError` if a file cannot be read, or the robot has no controllable joint.
    """
    source = read_source(urdf)
    postures = read_postures(srdf) if srdf is not None else {}
    draft, body, found = _feet(source, postures, feet, ())
    # A leg may end in a joint as light as a finger's: a second search keeps these joints.
    if found and min(len(body.limb(foot.joint).joints) for foot in found) < LEG_JOINTS:
        draft, body, found = _feet(source, postures, feet, [foot.link for foot in found])
    model = body.model
    if _put_base(source, model, base, found, draft) == "fixed":
        fixed = _model(draft, source)
        posture = put_fixed(fixed, postures, draft)
        tuning.put_armature(fixed, (), draft)
        tuning.put_limits(fixed, draft)
        tuning.put_arm_tasks(model, body.arms(), posture, draft)
    else:
        _put_legged(draft, model, body, found, postures)
        try:
            settings = draft.settings
            qp = make_qp(settings, make_model(settings, source.text))
        except ConfigurationError:  # the check of the draft reports it
            return draft
        tuning.put_activation_ramp(settings, qp, draft)
        tuning.put_walking(settings, qp, draft)
    return draft


def _feet(
    source: UrdfSource, postures: Postures, feet: Sequence[str], carrying: Sequence[str]
) -> tuple[Draft, Body, list[Foot]]:
    """Begin a draft, and return the feet; joints that move `carrying` are kept."""
    draft = Draft()
    draft.put("robot.urdf", source.address)
    draft.put("robot.base", "floating")
    choose_joints(source, draft, carrying)
    model = _model(draft, source)
    body = Body(model, _shapes(model, source, draft), srdf_posture(model, postures)[1])
    return draft, body, body.feet_on_links(feet) if feet else body.feet()


def _model(draft: Draft, source: UrdfSource) -> RobotModel:
    robot = draft.values["robot"]
    ranges = ranges_of(source, robot.get("joint_limits", {}))
    posture = [float(np.clip(0.0, *ranges[name])) for name in robot["joints"]]
    values = {"robot": robot | {"posture": posture}, "tasks": {"posture": {"type": "posture"}}}
    return make_model(parse_settings(values, source.address), source.text)


def _shapes(model: RobotModel, source: UrdfSource, draft: Draft) -> list[pin.GeometryObject]:
    """Read the collision shapes, or visual shapes of links without them; missing files get a note."""
    tree, folder, lost = copy.deepcopy(source.tree), source.path.parent, []
    for link in tree.iterfind("link"):
        measured = link.findall("collision") or link.findall("visual")
        for element in (*link.findall("collision"), *link.findall("visual")):
            mesh = element.find("geometry/mesh")
            if mesh is not None and not _is_there(str(mesh.get("filename")), folder):
                link.remove(element)
                if element in measured:
                    lost.append(str(link.get("name")))
    if lost:
        names = ", ".join(dict.fromkeys(lost))
        draft.note("contacts", f"shapes of {names}: the files are missing and were not measured.", "missing")
    bare = [
        str(link.get("name")) for link in tree.iterfind("link")
        if link.find("collision") is None and link.find("visual") is not None
    ]  # fmt: skip
    text = ElementTree.tostring(tree, encoding="unicode")
    return read_collision_elements(model, with_visuals(text, bare), "robot.urdf", folder)


def _is_there(mesh: str, folder: Path) -> bool:
    try:
        return locate(mesh if mesh.startswith(PACKAGE_SCHEME) else str(folder / mesh)).is_file()
    except ConfigurationError:
        return False


def _put_base(source: UrdfSource, model: RobotModel, base: Base | None, feet: Sequence[Foot], draft: Draft) -> Base:
    origin: Origin = "found"
    if base is not None:
        text = f"From --base {base}."
    elif virtual_joints(source.tree):
        base, text = "floating", "The joints between the root link and the base in the URDF represent a floating base."
    elif model.base_link == _WORLD:
        base, text = "fixed", f"The root link of the URDF is called {_WORLD!r}."
    elif len(feet) >= 2:
        names = ", ".join(foot.link for foot in feet)
        base, text, origin = "floating", f"Feet: {names}, the lowest ends of similar limbs.", "guess"
    else:
        text = "No feet found: no two similar limbs reach lower than all other parts. Name feet with --feet."
        base, origin = "fixed", "guess"
    draft.put("robot.base", base, text, origin)
    return base


def _put_legged(draft: Draft, model: RobotModel, body: Body, feet: Sequence[Foot], postures: Postures) -> None:
    height = body.height
    if not feet:
        draft.put("contacts", {}, "contacts: no feet found. Name the links of the feet with --feet.", "missing")
        put_fixed(model, postures, draft)
    else:
        posture = put_standing(model, feet, postures, draft)
        feet = Body(model, body.elements, posture).remeasured(feet)
        placement = Legs(model, feet, posture, keep_feet=True).place_feet(posture)
        height = float(placement.com[2] - placement.bottoms.mean())
        if len(feet) == 2 and all(foot.kind != "surface" for foot in feet):
            draft.note("contacts", "a third contact, or a surface: a robot cannot stand still on two points or "
                       "wheels.", "missing")  # fmt: skip
    tuning.put_armature(model, [body.limb(foot.joint) for foot in feet], draft)
    tuning.put_limits(model, draft)
    tuning.put_damping(model, height, draft)
    imus = [str(frame.name) for frame in links_of(model, 1) if "imu" in str(frame.name).lower()]
    if imus:
        draft.put("estimation.imu_frame", imus[-1], "From its name.", "guess")
    tuning.put_contacts(model, feet, draft)
    tuning.put_standing_tasks(model, body.arms(), feet, height, draft)
