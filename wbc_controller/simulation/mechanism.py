"""MuJoCo's model of the robot and the ground.

A contact of MuJoCo with the impedance d and ``solref`` (-k, -b) has the force (k r + b ṙ) / ((1 - d) A) at the depth r,
with the inverse mass A of the two bodies (`body_invweight0`): k = K (1 - d) A gives the stiffness K in N/m of soft
ground.
"""

import logging
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.controller.build.robot_description import are_possible_moments, inertia_tensor
from wbc_controller.controller.check.model_plausibility import massless_links
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.bare_mechanism import bare_mechanism
from wbc_controller.inverse_dynamics.robot.mimic import Followers
from wbc_controller.inverse_dynamics.robot.model import PassiveForces, RobotModel
from wbc_controller.inverse_dynamics.robot.urdf_structure import mass_of, vector_of
from wbc_controller.records import Array
from wbc_controller.settings import contacts as schema
from wbc_controller.settings.service import MockSettings, TerrainSettings
from wbc_controller.simulation.attachments import IMPEDANCE, STIFF_STEPS, Attachment, add_hoist, attach, frame_on_joint
from wbc_controller.simulation.shapes import CORNER_RADIUS, RIM_RADIUS, Shape, add_shape, rotation_to, wxyz

_log = logging.getLogger(__name__)

FLOOR = "floor"
SLAB, SLAB_DEPTH = 0.15, 0.01  # half side and half thickness of the slab of a contact between two links, m
#: Mass of a link without inertia, as a share of the robot's, and inertia per mass, m²; MuJoCo refuses zero.
_BARE_MASS, _BARE_INERTIA = 1.0e-6, 1.0e-2
ON_THE_FLOOR = 1  # collision bit of the ground: floor and terrain
FRICTION_STIFFNESS = 10.0  # stiffness of friction relative to the normal direction, against creep
_WORLD, _WORLD_ALIAS = "world", "<world>"
TERRAIN = "terrain/"  # prefix of the names of blocks' geoms
SOFT_IMPEDANCE = 0.5  # impedance of soft ground: it adds d / (1 - d) of the mass of a foot


def add_friction(model: Any, dof: Any, friction: float, step: float) -> None:
    """Add dry friction, N·m, to joints of a compiled model, by their velocity indices."""
    model.dof_frictionloss[dof] = friction
    # Default friction is soft: joints at rest would creep.
    model.dof_solref[dof] = STIFF_STEPS * step, 1.0
    model.dof_solimp[dof, :2] = IMPEDANCE


def balls_of(contact: schema.ContactSettings) -> tuple[Array, Array]:
    """Return centres, (n, 3), and half-axes, (3,), of balls or a wheel, m, with z along the axle."""
    if isinstance(contact, schema.SurfaceContact):
        corners = contact.corners
        return np.column_stack([corners, np.full(len(corners), CORNER_RADIUS)]), np.full(3, CORNER_RADIUS)
    if isinstance(contact, schema.FixedContact):
        return np.zeros((0, 3)), np.zeros(3)
    radius = contact.radius
    thin = isinstance(contact, schema.RollingContact)
    return np.zeros((1, 3)), np.array([radius, radius, RIM_RADIUS if thin else radius])


def _axle_frame(contact: schema.ContactSettings) -> Array:
    return rotation_to(np.array(contact.axis)) if isinstance(contact, schema.RollingContact) else np.eye(3)


def geom_names(name: str, contacts: Mapping[str, schema.ContactSettings]) -> list[str]:
    """Return the geom names of a contact's balls."""
    return [f"{name}/{index}" for index in range(len(balls_of(contacts[name])[0]))]


def _body_name(link: str) -> str:
    return _WORLD_ALIAS if link == _WORLD else link


def _mechanism(model: RobotModel) -> tuple[ET.Element, str]:
    """Return the URDF for MuJoCo, without shapes, and the name of its root link."""
    tree = bare_mechanism(ET.fromstring(model.urdf), model.moving_joints, model.locked)  # noqa: S314 - checked
    root = model.base_link
    if root != _WORLD or model.floating_base:
        # MuJoCo reserves this name for the world.
        for tag, key in (("link", "name"), ("joint/parent", "link"), ("joint/child", "link")):
            for element in tree.findall(tag):
                element.set(key, _body_name(str(element.get(key))))
        root = _body_name(root)
    extension = ET.SubElement(tree, "mujoco")
    # Keep the masses of the URDF. Links without joint stay separate: MuJoCo 3.3 fuses inertias incorrectly.
    ET.SubElement(extension, "compiler", balanceinertia="false", boundmass="0", boundinertia="0", fusestatic="false")
    return tree, root


def _write_inertias(spec: Any, tree: ET.Element, model: RobotModel) -> None:
    """Set the principal inertias of links, as MuJoCo 3.3 misreads rotated inertial origins."""
    balanced = []
    for link in tree.findall("link"):
        inertial, body = link.find("inertial"), spec.body(str(link.get("name")))
        if inertial is None or body.name == "world":
            continue
        origin, inertia = inertial.find("origin"), inertial.find("inertia")
        position, rotation = vector_of(origin, "xyz", "0 0 0"), pin.rpy.rpyToMatrix(vector_of(origin, "rpy", "0 0 0"))
        moments, axes = np.linalg.eigh(np.zeros((3, 3)) if inertia is None else inertia_tensor(inertia))
        axes[:, 2] *= np.linalg.det(axes)  # right-handed
        if not are_possible_moments(moments):  # MuJoCo refuses it
            balanced.append(str(link.get("name")))
            moments = np.full(3, moments.mean())
        # Rounding must not violate the triangle inequality of a flat link.
        moments[2] = min(moments[2], moments[0] + moments[1])
        body.explicitinertial = True
        body.mass = mass_of(link)
        body.ipos = position
        body.iquat = wxyz(rotation @ axes)
        body.inertia = moments
        body.fullinertia = np.full(6, np.nan)  # not given
    if balanced:
        _log.warning(
            "robot.urdf: invalid inertia of %s: the largest principal moment exceeds the sum of the others; the mock "
            "robot uses the mean of the three",
            ", ".join(balanced),
        )
    for name in massless_links(model):
        body = spec.body(_body_name(name))
        body.explicitinertial = True
        body.mass = _BARE_MASS * model.mass
        body.inertia = np.full(3, _BARE_INERTIA * body.mass)
        body.fullinertia = np.full(6, np.nan)  # not given


def _body(spec: Any, model: RobotModel, joint: int, root: str) -> Any:
    if joint == 0:
        return spec.worldbody
    name = model.pinocchio.names[joint]
    return spec.joint(name).parent if name in model.moving_joints else spec.body(root)


def _add_mimic_joints(spec: Any, followers: Followers) -> None:
    """Couple mimic joints to their leaders."""
    for name, mimic in followers.mimics.items():
        kind, joint = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
        equality = spec.add_equality(type=kind, objtype=joint, name1=name, name2=mimic.leader)
        equality.data[:5] = [mimic.offset, mimic.ratio, 0.0, 0.0, 0.0]


def _add_rotors(spec: Any, model: RobotModel) -> None:
    """Add the rotors of transmissions as fixed tendons with inertia; MuJoCo requires joints of one branch."""
    drive = model.actuation
    for name, ratios, inertia in zip(drive.names, drive.ratios, drive.rotor_inertia.tolist(), strict=True):
        if inertia == 0.0:
            continue
        driven = {joint: ratio for joint, ratio in zip(model.joints, ratios.tolist(), strict=True) if ratio != 0.0}
        last = max(model.pinocchio.getJointId(joint) for joint in driven)
        apart = [joint for joint in driven if model.pinocchio.getJointId(joint) not in model.pinocchio.supports[last]]
        if apart:
            raise ConfigurationError(
                f"robot.transmission.{name}.rotor_inertia = {inertia}: it couples {', '.join(apart)} with "
                f"{model.pinocchio.names[last]} on another branch, which MuJoCo does not support; use 0 for the mock"
            )
        tendon = spec.add_tendon(name=f"{name}/rotor", armature=inertia)
        for joint, ratio in driven.items():
            tendon.wrap_joint(joint, ratio)


def _add_springs(model: Any, passive: PassiveForces) -> None:
    """Add springs and dampers to the compiled model; MuJoCo 4's specification has polynomial stiffness."""
    for name, given in passive.joints.items():
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] = given.stiffness
        model.dof_damping[joint.dofadr[0]] = given.damping
        model.qpos_spring[joint.qposadr[0]] = given.rest


def _add_slab(
    spec: Any, model: RobotModel, contact: schema.ContactSettings, joint: int, placement: pin.SE3, root: str, bit: int
) -> None:
    """Add the slab that a contact touches, with a collision bit, to its link, at the contact in the nominal posture."""
    data = model.pinocchio.createData()
    pin.forwardKinematics(model.pinocchio, data, model.configuration(model.posture))
    other, frame = frame_on_joint(model, str(contact.against))
    face = data.oMi[other].actInv(data.oMi[joint] * placement)
    if isinstance(contact, schema.PointContact | schema.RollingContact):
        normal = frame.rotation @ np.array(contact.normal) / np.linalg.norm(contact.normal)
        reach = np.linalg.norm(balls_of(contact)[1] * ((face.rotation @ _axle_frame(contact)).T @ normal))
        face = pin.SE3(rotation_to(normal), face.translation - reach * normal)  # below the ball or wheel
    middle, size = face.act(np.array([0.0, 0.0, -SLAB_DEPTH])), [SLAB, SLAB, SLAB_DEPTH]
    _body(spec, model, other, root).add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=middle, quat=wxyz(face.rotation), mass=0.0, contype=bit,
        conaffinity=0,
    )  # fmt: skip


def blocks(terrain: TerrainSettings) -> list[tuple[pin.SE3, Array]]:
    """Return placements of centres and half sizes, (3,) in m, of the boxes of a block."""
    edge = pin.SE3(pin.rpy.rpyToMatrix(*terrain.rpy), np.array(terrain.position))
    length, width, thickness = terrain.size
    nx, ny = terrain.cells
    heights = np.random.default_rng(terrain.seed).uniform(-terrain.unevenness, terrain.unevenness, (nx, ny))
    half = 0.5 * np.array([length / nx, width / ny, thickness])
    x, y = length * (np.arange(nx) + 0.5) / nx, width * ((np.arange(ny) + 0.5) / ny - 0.5)
    centres = [np.array([x[i], y[j], heights[i, j] - half[2]]) for i, j in np.ndindex(nx, ny)]
    return [(edge * pin.SE3(np.eye(3), centre), half) for centre in centres]


def add_terrain(spec: Any, name: str, terrain: TerrainSettings, options: Mapping[str, Any]) -> None:
    """Add the boxes of a block, with options of their geoms, to a MuJoCo specification."""
    for index, (placement, half) in enumerate(blocks(terrain)):
        box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "name": f"{TERRAIN}{name}/{index}", "size": half}
        spec.worldbody.add_geom(**box, **options, pos=placement.translation, quat=wxyz(placement.rotation))


def soften(model: Any, terrain: Mapping[str, TerrainSettings], bodies: Iterable[int]) -> None:
    """Set stiffness and damping of soft blocks in a compiled model, for the mean inverse mass of the feet's bodies."""
    feet = list(bodies)
    if not feet:
        return
    scale = (1.0 - SOFT_IMPEDANCE) * float(np.mean(model.body_invweight0[feet, 0]))
    for name, block in terrain.items():
        if block.stiffness is None:
            continue
        for index in range(len(blocks(block))):
            geom = model.geom(f"{TERRAIN}{name}/{index}")
            geom.solref[:] = -scale * block.stiffness, -scale * block.damping
            geom.solimp[:2] = SOFT_IMPEDANCE


def compile_mechanism(
    model: RobotModel,
    contacts: Mapping[str, schema.ContactSettings],
    step: float,
    mock: MockSettings,
    shapes: Mapping[int, Sequence[Shape]],
    attachments: Mapping[str, Attachment],
) -> Any:
    """Build MuJoCo's model; the step is in s.

    `shapes` of links that touch the floor are by Pinocchio joint; other links use the shapes of their contacts.
    """
    tree, root = _mechanism(model)
    stiff = [STIFF_STEPS * step, 1.0]
    impedance = [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]

    def surface(friction: float) -> dict[str, Any]:
        return {"priority": 1, "condim": 3, "friction": [friction, 0.0, 0.0], "solref": stiff, "solimp": impedance}

    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: MuJoCo cannot read it: {error}") from error
    _write_inertias(spec, tree, model)
    spec.option.timestep = step
    spec.option.gravity = np.array(model.pinocchio.gravity.linear)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = FRICTION_STIFFNESS
    spec.default.equality.solref, spec.default.equality.solimp = stiff, impedance
    for name, index in zip(model.joints, model.v_index, strict=True):
        joint = spec.joint(name)
        joint.armature = float(model.pinocchio.armature[index])
        joint.solref_limit = stiff
    _add_rotors(spec, model)
    if model.followers is not None:
        _add_mimic_joints(spec, model.followers)
    if model.floating_base:
        spec.body(root).add_freejoint()
        add_hoist(spec, root)
    if contacts:
        ground = {"contype": ON_THE_FLOOR, "conaffinity": 0}
        rotation, plane = rotation_to(np.array(mock.floor_normal)), mujoco.mjtGeom.mjGEOM_PLANE
        floor = {"name": FLOOR, "type": plane, "size": [0.0, 0.0, 1.0], "quat": wxyz(rotation)}
        spec.worldbody.add_geom(**floor, **ground, **surface(mock.friction))
        for name, block in mock.terrain.items():
            friction = mock.friction if block.friction is None else block.friction
            add_terrain(spec, name, block, ground | surface(friction))
        for joint, own in shapes.items():
            body = _body(spec, model, joint, root)
            for index, shape in enumerate(own):
                add_shape(spec, body, shape, f"{body.name}/shape/{index}", ON_THE_FLOOR)
    for number, (name, contact) in enumerate(contacts.items()):
        joint, placement = contact_placement(model, name, contact)
        body = _body(spec, model, joint, root)
        if contact.against is None and joint in shapes:
            continue
        centres, axes = balls_of(contact)
        ball: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "size": axes, "mass": 0.0}
        if axes[0] == axes[2]:
            ball |= {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [axes[0], 0.0, 0.0]}
        ball |= {"quat": wxyz(placement.rotation @ _axle_frame(contact)), "contype": 0, "conaffinity": ON_THE_FLOOR}
        if contact.against is not None and not isinstance(contact, schema.FixedContact):
            bit = 2 << (1 + number % 28)  # a collision bit per slab
            _add_slab(spec, model, contact, joint, placement, root, bit)
            ball |= {"conaffinity": bit, **surface(contact.friction)}
        for geom_name, centre in zip(geom_names(name, contacts), centres, strict=True):
            body.add_geom(name=geom_name, pos=placement.act(centre), **ball)
    for attachment in attachments.values():
        holder, link = (_body(spec, model, joint, root).name for joint in attachment.joints)
        attach(spec, attachment, (holder, link))
    try:
        compiled = spec.compile()
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: MuJoCo cannot use it: {error}") from error
    if model.passive is not None:
        _add_springs(compiled, model.passive)
    return compiled
