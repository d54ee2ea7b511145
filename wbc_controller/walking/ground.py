"""The ground below the feet: the plane that fits their places."""

from collections.abc import Iterable
from dataclasses import dataclass

from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Ground:
    """A plane: place x + i y in m and height z in m of one point, and the rise per metre in x and y."""

    place: complex
    height: float
    slope: tuple[float, float]

    def height_at(self, place: complex) -> float:
        """Return the height at a place, m."""
        to = place - self.place
        return self.height + self.slope[0] * to.real + self.slope[1] * to.imag

    @classmethod
    def below(cls, points: Iterable[Array]) -> "Ground":
        """Return the plane with the smallest squared vertical distances to points, at least three, not on a line.

        With x, y and z relative to their means, the rise s solves Σ (x, y)ᵀ(x, y) s = Σ (x, y)ᵀ z.
        """
        rows = [point.tolist() for point in points]
        n = len(rows)
        x0, y0, z0 = (sum(row[i] for row in rows) / n for i in range(3))
        xx = xy = yy = xz = yz = 0.0
        for x, y, z in rows:
            x, y, z = x - x0, y - y0, z - z0
            xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
        determinant = xx * yy - xy * xy
        slope = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
        return cls(complex(x0, y0), z0, slope)
