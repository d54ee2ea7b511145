"""Kernel for the plane of the ground under point feet."""

from __future__ import annotations

from wbc_controller.compilation import Matrix, compiled


@compiled
def plane_below(points: Matrix) -> tuple[complex, float, complex]:
    """Return the mean place and height of points, (n, 3), and the slope of the plane of `Ground.below`.

    With x, y and z relative to their means, the slope s solves Σ (x, y)ᵀ(x, y) s = Σ (x, y)ᵀ z.
    """
    n = len(points)
    if points.shape[1] != 3 or n < 3:
        raise ValueError("plane_below: wrong size")
    x0 = y0 = z0 = xx = xy = yy = xz = yz = 0.0
    for i in range(n):
        x0, y0, z0 = x0 + points[i, 0] / n, y0 + points[i, 1] / n, z0 + points[i, 2] / n
    for i in range(n):
        x, y, z = points[i, 0] - x0, points[i, 1] - y0, points[i, 2] - z0
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    return complex(x0, y0), z0, complex(xz * yy - yz * xy, yz * xx - xz * xy) / (xx * yy - xy * xy)
