"""The contacts: one file per kind, derived from the base classes in `contact`."""

from wbc_controller.core.contacts.contact import AnchoredContact, Contact, UnilateralContact
from wbc_controller.core.contacts.fixed import FixedContact
from wbc_controller.core.contacts.loop import LoopClosure
from wbc_controller.core.contacts.mount import placement_of
from wbc_controller.core.contacts.point import PointContact
from wbc_controller.core.contacts.rolling import RollingContact
from wbc_controller.core.contacts.support import Polygon, Rectangle, polygon_wrench_cone, wrench_cone
from wbc_controller.core.contacts.surface import SurfaceContact

__all__ = [
    "AnchoredContact",
    "Contact",
    "FixedContact",
    "LoopClosure",
    "PointContact",
    "Polygon",
    "Rectangle",
    "RollingContact",
    "SurfaceContact",
    "UnilateralContact",
    "placement_of",
    "polygon_wrench_cone",
    "wrench_cone",
]
