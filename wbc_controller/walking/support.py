"""Area of the centre of pressure."""

import cmath
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Support:
    """Rectangles around all points of the line between two feet; on one foot both places are the same.

    Attributes:
        first: place of a foot, x + i y in m.
        second: place of the other one.
        heading: of the rectangles, rad.
        half: half length and half width of the rectangles, m.
    """

    first: complex
    second: complex
    heading: float
    half: tuple[float, float]

    def nearest(self, point: complex) -> complex:
        """Return the nearest point of the rectangle around the nearest point of the line."""
        line = self.second - self.first
        length = abs(line) ** 2
        share = ((point - self.first) * line.conjugate()).real / length if length > 0.0 else 0.0
        centre = self.first + max(0.0, min(1.0, share)) * line
        axes = cmath.rect(1.0, self.heading)
        local = (point - centre) / axes
        x = max(-self.half[0], min(self.half[0], local.real))
        y = max(-self.half[1], min(self.half[1], local.imag))
        return centre + complex(x, y) * axes
