"""Construction of contacts and loop closures."""

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics import contacts
from wbc_controller.inverse_dynamics.robot.instruction import placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings import contacts as schema

#: Settings with the same name and value in the classes of contacts.
_PASSED = {"against", "damping", "stiffness", "max_force", "friction", "min_normal_force", "max_normal_force"}


def make_contact(name: str, contact: schema.ContactSettings, model: RobotModel) -> contacts.Contact:
    """Build one contact."""
    base, translation = (name, model, contact.frame), np.array(contact.translation)
    given = contact.model_dump(include=_PASSED)
    if isinstance(contact, schema.FixedContact):
        placement = contacts.placement_of(contact.translation, contact.rpy)
        return contacts.FixedContact(*base, placement, contact.mask, max_moment=contact.max_moment or 0.0, **given)
    least, most = contact.min_normal_force, contact.max_normal_force
    if least > most:
        problem = f"min_normal_force = {least} is larger than max_normal_force = {most}"
        raise ConfigurationError(f"contacts.{name}: {problem}")
    if isinstance(contact, schema.SurfaceContact):
        support = (
            contacts.Rectangle(contact.half_length or 0.0, contact.half_width or 0.0)
            if contact.vertices is None
            else contacts.Polygon(np.array(contact.vertices), f"contacts.{name}.vertices")
        )
        given |= {"max_yaw_moment": np.inf if contact.max_yaw_moment is None else contact.max_yaw_moment}
        return contacts.SurfaceContact(*base, contacts.placement_of(contact.translation, contact.rpy), support, **given)
    normal = np.array(contact.normal)
    if isinstance(contact, schema.RollingContact):
        axis = np.array(contact.axis)
        return contacts.RollingContact(*base, translation, contact.radius, axis, normal=normal, **given)
    return contacts.PointContact(*base, translation, contact.radius, normal=normal, **given)


def contact_placement(model: RobotModel, name: str, contact: schema.ContactSettings) -> tuple[int, pin.SE3]:
    """Return the Pinocchio joint of a contact, and its placement in the joint's frame."""
    placement = contacts.placement_of(contact.translation, getattr(contact, "rpy", (0.0, 0.0, 0.0)))
    return placement_on_link(model, model.frame_id(contact.frame, f"contacts.{name}.frame"), placement)


def make_loop_closure(name: str, loop: schema.LoopSettings, model: RobotModel) -> contacts.LoopClosure:
    """Build a loop closure."""
    frames, place = (loop.frame_a, loop.frame_b), contacts.placement_of
    placements = place(loop.translation_a, loop.rpy_a), place(loop.translation_b, loop.rpy_b)
    return contacts.LoopClosure(name, model, frames, placements, loop.mask, stiffness=loop.stiffness)
