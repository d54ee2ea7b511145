"""The version of an object's parameters: tasks, contacts and limits count the changes of their attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any


class Tunable:
    """A task, contact or limit, whose attributes may be set between two cycles, such as gains and force limits.

    The quadratic program keeps arrays that depend on them (`formulation.structure`) until a version changes. A change
    within an array, such as ``task.stiffness[0] = 1.0``, is not counted: set the attribute.

    Attributes:
        version: number of changes of attributes without a leading underscore.
    """

    version: int = 0

    if not TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if not name.startswith("_"):
                super().__setattr__("version", self.version + 1)
