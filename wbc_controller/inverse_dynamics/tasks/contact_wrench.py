"""Task on the force of a contact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.tasks.task import Efforts, EffortTask
from wbc_controller.records import Array, Reference

_AXES = ("x", "y", "z", "about x", "about y", "about z")


class ContactWrenchTask(EffortTask):
    """Task on the wrench of a contact, (6,) in N and N·m, in the axes in which it is published (`Contact.basis`).

    While the contact is not active the task has no rows.
    """

    unit = "N, N·m"
    size = 6

    def __init__(self, name: str, contact: Contact, mask: Sequence[bool], target: Sequence[float]) -> None:
        """Make a task with the wrench until a command sets another one, (6,) in N and N·m.

        Raises:
            ConfigurationError: if the mask selects no axis along which the contact transmits a force or moment.
        """
        super().__init__(name, mask, np.array(target, dtype=np.float64))
        borne = np.flatnonzero(contact.basis.any(axis=1))
        self.rows = np.intersect1d(self.rows, borne)
        if not len(self.rows):
            raise ConfigurationError(
                f"tasks.{name}.mask leaves no axis: contact {contact.name!r} has forces and moments along "
                f"{', '.join(_AXES[axis] for axis in borne)}"
            )
        self._basis = contact.basis[self.rows]
        self.contact = contact.name

    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array] | None:
        """R that maps the decision variables to the wrench, (k, n), and the wrench of the reference, (k,)."""
        force = efforts.force_map(self.contact)
        return None if force is None else (self._basis @ force, reference.position[self.rows])
