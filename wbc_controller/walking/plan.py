"""Record of the walker's plan for viewers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.walking.gait import Phase
from wbc_controller.walking.swing_kernels import Landing, moved

_POINTS = 10  # points of the path of a swing foot
_ON_EDGE = 1.0e-9  # distance within which a point counts as on an edge, m


@dataclass(frozen=True, slots=True)
class WalkingPlan:
    """Plan of one cycle. Points in the world in m, on the ground x + i y."""

    phase: str
    dcm: complex  # measured DCM ξ
    wanted_dcm: complex  # its reference ξ*
    #: Planned path of each foot in the air, from its present reference to the touchdown, (n, 3), by contact.
    swings: Mapping[str, Array]
    landings: Mapping[str, Array]  # planned touchdowns, (3,), by contact
    remaining: float  # time until the next touchdown, s; infinite without a foot in the air
    margin: float  # least distance of the planned centre of pressure to the edge of the support, m; negative outside

    @classmethod
    def of(
        cls, phase: Phase, dcm: complex, wanted_dcm: complex, swings: Mapping[str, tuple[Array, Landing]],
        clearance: float, elapsed: float, margin: float,
    ) -> "WalkingPlan":  # fmt: skip
        """Return the plan with motions (3, 4) and touchdowns of the feet in the air; other arguments of `moved`."""
        return cls(
            phase=phase.value,
            dcm=dcm,
            wanted_dcm=wanted_dcm,
            swings={name: swing_path(*each, clearance, elapsed) for name, each in swings.items()},
            landings={name: np.array([to.place.real, to.place.imag, to.height]) for name, (_, to) in swings.items()},
            remaining=min((max(0.0, to.time - elapsed) for _, to in swings.values()), default=math.inf),
            margin=margin,
        )


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
