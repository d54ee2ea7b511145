"""Contact wrench task."""

from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.tasks.task import Efforts, EffortTask
from wbc_controller.records import Array, Reference

_AXES = ("x", "y", "z", "about x", "about y", "about z")


class ContactWrenchTask(EffortTask):
    """Task on a contact wrench, (6,) in N and N·m, in the axes of `Contact.basis`; no rows for an inactive contact."""

    unit = "N, N·m"
    size = 6

    def __init__(self, name: str, contact: Contact, mask: Sequence[bool], target: Sequence[float]) -> None:
        """Make a task with a default reference wrench, (6,) in N and N·m.

        Raises:
            ConfigurationError: if the mask selects no axis of a transmitted force or moment.
        """
        super().__init__(name, mask, np.array(target, dtype=np.float64))
        borne = np.flatnonzero(contact.basis.any(axis=1))
        self.rows = np.intersect1d(self.rows, borne)
        if not len(self.rows):
            raise ConfigurationError(
                f"tasks.{name}.mask selects no force or moment of contact {contact.name!r}; valid: "
                f"{', '.join(_AXES[axis] for axis in borne)}"
            )
        self._basis = contact.basis[self.rows]
        self.contact = contact.name

    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array] | None:
        """Return R (k, n) of the wrench, and the reference wrench (k,)."""
        force = efforts.force_map(self.contact)
        return None if force is None else (self._basis @ force, reference.position[self.rows])
