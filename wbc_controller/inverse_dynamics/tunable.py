"""Version counter for the parameters of tasks, contacts and limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any


class Tunable:
    """Base class that counts attribute changes, such as of gains and force limits between two cycles.

    Arrays of the quadratic program that depend on the attributes are reused until a version changes
    (`formulation.structure`). Assign the attribute to count a change: a change in place, ``task.stiffness[0] = 1.0``,
    is not counted.

    Attributes:
        version: number of assignments to attributes without a leading underscore.
    """

    version: int = 0

    if not TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if not name.startswith("_"):
                super().__setattr__("version", self.version + 1)
