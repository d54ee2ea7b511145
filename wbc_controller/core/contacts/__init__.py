"""The contacts: one file per kind, on the base class of `contact`."""

from wbc_controller.core.contacts.contact import Contact
from wbc_controller.core.contacts.point import PointContact
from wbc_controller.core.contacts.surface import SurfaceContact, wrench_cone

__all__ = ["Contact", "PointContact", "SurfaceContact", "wrench_cone"]
