"""Contacts."""

from wbc_controller.inverse_dynamics.contacts.contact import AnchoredContact, Contact, UnilateralContact
from wbc_controller.inverse_dynamics.contacts.fixed import FixedContact
from wbc_controller.inverse_dynamics.contacts.loop import LoopClosure
from wbc_controller.inverse_dynamics.contacts.mount import placement_of
from wbc_controller.inverse_dynamics.contacts.point import PointContact, RollingContact
from wbc_controller.inverse_dynamics.contacts.support import Polygon, Rectangle, polygon_wrench_cone, wrench_cone
from wbc_controller.inverse_dynamics.contacts.surface import SurfaceContact

__all__ = [
    "AnchoredContact", "Contact", "FixedContact", "LoopClosure", "PointContact", "Polygon", "Rectangle",
    "RollingContact", "SurfaceContact", "UnilateralContact", "placement_of", "polygon_wrench_cone", "wrench_cone",
]  # fmt: skip
