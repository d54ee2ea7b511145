"""Version counter of parameters."""

from typing import TYPE_CHECKING, Any


class Tunable:
    """Base class that counts attribute changes.

    Arrays are reused until a version changes (`formulation.formulation`). Changes in place, e.g. ``task.stiffness[0] =
    1.0``, are not counted: assign the attribute.
    """

    version: int = 0  # number of assignments to public attributes

    if not TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if not name.startswith("_"):
                super().__setattr__("version", self.version + 1)
