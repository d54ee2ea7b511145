"""Force of a contact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbc_controller.core.contacts import Contact
from wbc_controller.core.problem import FORCE_UNIT, Layout
from wbc_controller.core.tasks.task import EffortTask
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array, Reference


class ContactWrenchTask(EffortTask):
    """Wrench of a contact in its own axes, (6,) in N and N·m; of a contact with three forces the first three.

    While the contact is broken the task asks for nothing.
    """

    size = 6

    def __init__(self, name: str, contact: Contact, mask: Sequence[bool], target: Sequence[float]) -> None:
        """Make a task.

        Args:
            name: the task's name.
            contact: the contact.
            mask: its axes concerned, (6,).
            target: the wrench before another one is given, (6,) in N and N·m.

        Raises:
            ConfigurationError: where the mask leaves none of the contact's forces.
        """
        super().__init__(name, mask, np.array(target, dtype=np.float64))
        self.rows = self.rows[self.rows < contact.size]
        if not len(self.rows):
            raise ConfigurationError(
                f"tasks.{name}.mask leaves no axis: contact {contact.name!r} has {contact.size} forces, along "
                f"the first {contact.size} axes"
            )
        self.contact = contact.name

    def equation(self, layout: Layout, reference: Reference) -> tuple[Array, Array] | None:
        """Selection of the contact's columns, (k, n), and the wrench, (k,)."""
        if self.contact not in layout.key:
            return None
        columns = layout.forces[layout.key.index(self.contact)]
        rows = np.zeros((self.dimension, len(layout.problem.g)))
        rows[np.arange(self.dimension), columns.start + self.rows] = FORCE_UNIT
        return rows, reference.position[self.rows]
