"""Counter of parameter changes."""

from typing import TYPE_CHECKING, Any


class ChangeCounter:
    """Number of assignments to public attributes of the watched objects."""

    count = 0


class Tunable:
    """Base class that counts attribute changes.

    Arrays are reused until a parameter changes (`formulation.structure`). Changes in place, e.g. ``task.stiffness[0] =
    1.0``, are not counted: assign the attribute.
    """

    _counters: tuple[ChangeCounter, ...] = ()

    def count_changes(self, counter: ChangeCounter) -> None:
        """Add later assignments to a counter."""
        if counter not in self._counters:
            self._counters = (*self._counters, counter)

    if not TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if not name.startswith("_"):
                for counter in self._counters:
                    counter.count += 1
