"""Record of the walker's plan for viewers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.walking.swing import Landing, moved

#: Points of the path of a swing foot.
_POINTS = 10
#: Distance within which a point counts as on an edge, m.
_ON_EDGE = 1.0e-9


@dataclass(frozen=True, slots=True)
class WalkingPlan:
    """Plan of one cycle. Points in the world in m, on the ground x + i y.

    Attributes:
        dcm: measured DCM ξ.
        wanted_dcm: its reference ξ*.
        swings: planned path of each foot in the air, from its present reference to the touchdown, (n, 3), by contact.
        landings: planned touchdowns, (3,), by contact.
        remaining: time until the next touchdown, s; infinite without a foot in the air.
        margin: least distance of the planned centre of pressure to the edge of the support, m; negative outside.
    """

    phase: str
    dcm: complex
    wanted_dcm: complex
    swings: Mapping[str, Array]
    landings: Mapping[str, Array]
    remaining: float
    margin: float


def swing_path(swing: Array, landing: Landing, clearance: float, elapsed: float) -> Array:
    """Return the path from the present reference to a fixed touchdown, (n, 3); arguments of `moved`."""
    dt, feet = max(0.0, landing.time - elapsed) / _POINTS, [swing]
    for i in range(_POINTS):
        feet.append(moved(feet[-1], landing, clearance, elapsed + i * dt, dt))
    return np.array([foot[0, :3] for foot in feet])


def margin(point: complex, corners: Sequence[complex]) -> float:
    """Return the least distance of a point to the edges of the convex hull of some corners, m; negative outside."""
    c = np.array(corners)
    edges = c - c[:, np.newaxis]  # from each corner to each other one, (n, n)
    left = (edges.conj()[:, :, np.newaxis] * (c - c[:, np.newaxis, np.newaxis])).imag  # of each corner, (n, n, n)
    length = np.abs(edges)
    outer = (left >= -_ON_EDGE * length[:, :, np.newaxis]).all(axis=2) & (length > _ON_EDGE)
    distances = (edges.conj() * (point - c[:, np.newaxis])).imag[outer] / length[outer]
    return float(distances.min())
