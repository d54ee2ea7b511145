"""Area of the centre of pressure, and its supported strip.

A sole on the edge of a stone tips about a line. There its vertical speed ż + ω_x y is zero, with the vertical speed ż
of its centre and the angular velocity ω_x about the heading. The ground supports the rising side. If the centre of
pressure were on the other side, the sole would tip until the ankle is at the end of its range.
"""

from __future__ import annotations

import cmath

from wbc_controller.compilation import compiled

#: Least angular velocity of a tipping sole, rad/s.
_TIPPING = 1.0
#: Largest distance of the line from the centre, as a share of the usable half width.
_FARTHEST = 1.7
#: Distance of the strip from the line, and its least width, m.
_INSIDE, _NARROWEST = 0.005, 0.004
#: Rate at which both ends of the strip return, m/s.
_RETURN = 0.1


@compiled
def nearest_in_support(
    point: complex, first: complex, second: complex, heading: float, length: float, right: float, left: float
) -> complex:
    """Return the nearest point of the rectangle around the nearest point of the line between two feet.

    Args:
        point: x + i y in m.
        first, second: places of the feet; on one foot both are the same.
        heading: of the rectangle, rad.
        length: half length of the rectangle, m.
        right, left: ends of its width, m from the line to the left.
    """
    line, axes = second - first, cmath.rect(1.0, heading)
    squared = abs(line) ** 2
    share = ((point - first) * line.conjugate()).real / squared if squared > 0.0 else 0.0
    centre = first + max(0.0, min(1.0, share)) * line
    local = (point - centre) / axes
    return centre + complex(max(-length, min(length, local.real)), max(right, min(left, local.imag))) * axes


@compiled
def supported_strip(
    right: float, left: float, width: float, rise: float, rotation: complex, dt: float
) -> tuple[float, float]:
    """Return the ends of the supported strip of a sole after one cycle, m from the centre to the left.

    Args:
        right, left: ends in the last cycle.
        width: usable half width of the sole, m.
        rise, rotation: vertical velocity of the centre, m/s, and ω_x + i ω_y about the heading and to its left, rad/s.
        dt: period, s.
    """
    right, left = max(-width, right - _RETURN * dt), min(width, left + _RETURN * dt)
    rolling = rotation.real
    if abs(rolling) < max(_TIPPING, abs(rotation.imag)) or abs(rise) > _FARTHEST * width * abs(rolling):
        return right, left
    line = -rise / rolling
    if rolling > 0.0:
        return max(right, min(line + _INSIDE, left - _NARROWEST, width - _NARROWEST)), left
    return right, min(left, max(line - _INSIDE, right + _NARROWEST, _NARROWEST - width))
