"""Shapes of a robot with contacts."""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings, FixedContact, PointContact, RollingContact, SurfaceContact
from wbc_controller.simulation.mechanism import rotation_to
from wbc_controller.simulation.shapes import Shape, read_shapes

_log = logging.getLogger(__name__)


def shapes_for_contacts(
    model: RobotModel, contacts: Mapping[str, ContactSettings], folder: Path | None, floor_normal: Array
) -> dict[int, list[Shape]]:
    """Read the collision shapes by Pinocchio joint, as the contacts with the floor need them; none without contacts.

    `folder` of meshes with relative paths. Warns about links that need the shapes of their contacts.
    """
    if not contacts:
        return {}
    soles: dict[int, list[Array]] = {}
    tips: dict[int, Array] = {}
    wheels: dict[int, pin.SE3] = {}
    standing: dict[str, int] = {}
    data = model.pinocchio.createData()
    pin.forwardKinematics(model.pinocchio, data, model.configuration(model.posture))
    for name, contact in contacts.items():
        joint, placement = contact_placement(model, name, contact)
        if contact.against is None and not isinstance(contact, FixedContact):
            standing[name] = joint
            if isinstance(contact, SurfaceContact):
                soles.setdefault(joint, []).append(-placement.rotation[:, 2])
            elif isinstance(contact, PointContact):
                tips[joint] = -data.oMi[joint].rotation.T @ floor_normal
            elif isinstance(contact, RollingContact):
                wheels[joint] = placement * pin.SE3(rotation_to(np.array(contact.axis)), np.zeros(3))
    try:
        shapes, why = read_shapes(model, soles, tips, wheels, folder), "have no collision element in the URDF"
    except ConfigurationError as error:  # meshes are optional
        shapes, why = {}, f"have no shapes ({error})"
    bare = [name for name, joint in standing.items() if joint not in shapes]
    if bare:
        _log.warning(
            "the links of the contacts %s %s: the mock robot uses the contact shapes of the configuration",
            ", ".join(bare),
            why,
        )
    return shapes
