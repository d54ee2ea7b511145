"""Form of a reference."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.arguments import finite, shortened, unit_quaternion
from wbc_controller.errors import InputRefused
from wbc_controller.records import Array

_SHORTEST_DIRECTION = 1.0e-6


@dataclass(frozen=True, slots=True)
class ReferenceForm:
    """Form of a reference position: a vector, optionally followed by a quaternion."""

    vector: int = 3  # components
    oriented: bool = False  # True if a quaternion (x, y, z, w) follows the vector
    direction: bool = False  # True for a direction of any non-zero length

    @property
    def size(self) -> int:
        """Size of a position."""
        return self.vector + (4 if self.oriented else 0)

    @property
    def rate_size(self) -> int:
        """Size of a velocity or acceleration."""
        return self.vector + (3 if self.oriented else 0)

    @property
    def twist(self) -> slice:
        """Twist components (linear, angular) in the reference velocity."""
        return slice(0 if self.vector else 3, 6 if self.oriented else self.vector)

    def position(self, values: Any, what: str) -> Array:
        """Read a position (size,), and normalize its direction or quaternion.

        Raises `InputRefused` for a wrong size, norm or value; `what` names the values.
        """
        array = np.array(finite(values, what))
        if self.size == 1 and array.shape == ():
            array = array.reshape(1)
        if array.shape != (self.size,):
            raise InputRefused(f"{what} has the shape {array.shape}; it takes ({self.size},)")
        if self.direction:
            norm = float(np.linalg.norm(array))
            if not (_SHORTEST_DIRECTION <= norm < np.inf):
                raise InputRefused(f"{what} {shortened(array)} has no direction (length {norm:.3g})")
            array /= norm
        if self.oriented:
            array[self.vector :] = unit_quaternion(array[self.vector :], f"{what}: ")
        return array
