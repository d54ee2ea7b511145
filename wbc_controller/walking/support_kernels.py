"""Area of the centre of pressure."""

from __future__ import annotations

import cmath

from wbc_controller.compilation import compiled


@compiled
def nearest_in_support(
    point: complex, first: complex, second: complex, heading: float, length: float, width: float
) -> complex:
    """Return the nearest point of the rectangle around the nearest point of the line between two feet.

    Args:
        point: x + i y in m.
        first, second: places of the feet; on one foot both are the same.
        heading: of the rectangle, rad.
        length, width: half length and half width of the rectangle, m.
    """
    line, axes = second - first, cmath.rect(1.0, heading)
    squared = abs(line) ** 2
    share = ((point - first) * line.conjugate()).real / squared if squared > 0.0 else 0.0
    centre = first + max(0.0, min(1.0, share)) * line
    local = (point - centre) / axes
    return centre + complex(max(-length, min(length, local.real)), max(-width, min(width, local.imag))) * axes
