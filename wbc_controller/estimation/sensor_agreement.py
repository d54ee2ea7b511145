"""Agreement of the base's sensors with the legs: gravity at rest, then turns and displacements in the first motion.

The joints give the points y of the contacts from the sensor and in its axes. If the contacts hold, a turn θ and a
displacement p of the sensor, both in its axes, move the points by

    Δy = y × θ - p

Least squares over all points gives θ and p without the sensor. They are compared with the integrals of the measured
angular velocity ω and velocity v. All of them pass the same high-pass filter, so that no drift adds up,

    Δy ← exp(-Δt / T) (Δy + δy)        b ← exp(-Δt / T) (b + ω Δt), likewise with v

With correct axes and units, the sensor's b is the legs' a = θ or p. A contradiction b - a has other causes too: feet
that slip, ground that moves, a hoist. Therefore it counts only if an error of axes or units explains it
(`axes_comparison`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from wbc_controller.estimation.axes_comparison import AxesComparison, vector_text
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.inverse_dynamics.arrays import cross, sum_of_squares
from wbc_controller.records import Array

#: Time constant T of the high-pass filter, s.
HIGH_PASS = 0.3
#: Time between two looks, s.
PERIOD = 0.02
#: Largest share of |Δy|² that no motion of the sensor explains: otherwise the contacts move against each other.
_RIGID = 0.1
#: Smallest distance of points from a line through their middle that determines a turn, or a plane, √Σ in m.
_SPREAD = 0.02
#: Cosine of the largest angle between the normal of the contacts and the vertical, 60°: steeper, no friction holds.
_STEEP = 0.5
#: Smallest distance of the centre of mass from the plane of the contacts that tells its upper side, m.
_ABOVE = 0.02


def gravity_contradiction(kinematics: LegKinematics, holding: Sequence[str], up: Array) -> str | None:
    """Return a sentence if the contacts cannot hold a robot with this vertical; None if they can, or it is not known.

    Soles have a normal each, and balls the normal of the plane through all of them, towards the centre of mass. The
    vertical `up` is a unit vector in the axes of the sensor, (3,).
    """
    center = kinematics.center_of_mass()
    normals = [_normal(points, center) for points in _planes(kinematics, holding)]
    best = max((normal for normal in normals if normal is not None), key=lambda n: float(n @ up), default=None)
    if best is None or best @ up >= _STEEP:
        return None
    angle = math.acos(max(-1.0, float(best @ up)))
    across = np.cross(best, up)
    axis = "xyz"[int(np.abs(across).argmax())]
    why = "its sign is wrong, or its z axis points down" if angle > 2.6 else f"as if rotated about its {axis} axis"
    return (
        f"up is along {vector_text(up)} of {kinematics.imu_frame}, and along {vector_text(best)} by the contacts "
        f"({', '.join(holding)}), {math.degrees(angle):.0f}° apart: {why}"
    )


def _planes(kinematics: LegKinematics, holding: Sequence[str]) -> Iterator[Array]:
    """Points, (n, 3) in m, of each sole, and of all balls together, in the axes of the sensor."""
    balls = tuple(name for name in holding if name in kinematics.rolling)
    if len(balls) > 2:
        yield kinematics.places(balls)
    for name in holding:
        if name in kinematics.soles:
            yield kinematics.places((name,))


def _normal(points: Array, center: Array) -> Array | None:
    """Unit normal of a plane through points, (n, 3) in m, towards the centre of mass, (3,) in m; None if unknown."""
    middle = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - middle)
    height = float((center - middle) @ axes[2])
    if spread[1] < _SPREAD or abs(height) < _ABOVE:
        return None
    return np.asarray(math.copysign(1.0, height) * axes[2])


class SensorAgreement:
    """Compares turns, and optionally displacements, that a sensor measures with those by the legs.

    Args:
        kinematics: from the sensor's frame to the contacts.
        sensor: name of the sensor in sentences.
        moves: whether the sensor measures displacements too.
    """

    def __init__(self, kinematics: LegKinematics, sensor: str, *, moves: bool) -> None:
        self._kinematics, self._sensor = kinematics, sensor
        self.comparison = AxesComparison(moves=moves)
        self._measured = np.zeros((2 if moves else 1, 3))  # b, in rad and m
        self._contacts: tuple[str, ...] = ()
        self._places = self._moved = np.zeros((0, 3))  # y at the last look, and Δy

    def look(
        self,
        elapsed: float,
        steps: Array,
        holding: tuple[str, ...],
        world: Array | None = None,
        *,
        at_once: bool = False,
    ) -> str | None:
        """Compare the motion up to now; return a sentence if an error of axes or units explains a contradiction.

        Args:
            elapsed: time since the last look, s.
            steps: measured turn, and displacement, since the last look in the axes of the sensor, (n, 3) in rad and m.
            holding: names of the contacts that hold; they have points.
            world: rotation from the axes of the sensor to the world, (3, 3), if its data could be in the world's axes.
            at_once: whether the sensor is known to be wrong: then a small contradiction counts too.
        """
        before, self._places = self._places, self._kinematics.places(holding)
        if holding != self._contacts:
            self._contacts, self._moved = holding, np.zeros_like(self._places)
            self._measured = np.zeros_like(self._measured)
            return None
        keep = math.exp(-elapsed / HIGH_PASS)
        self._moved = keep * (self._moved + self._places - before)
        self._measured = keep * (self._measured + steps)
        by_legs = _motion(self._places, self._moved)
        if by_legs is None:
            return None
        found = self.comparison.update(elapsed, by_legs[: len(steps)], self._measured, world, at_once=at_once)
        return found and f"{self._sensor} contradicts the legs ({', '.join(holding)}): {found}"


def _motion(places: Array, moved: Array) -> Array | None:
    """Return θ and p, (2, 3) in rad and m, of points y that have moved by Δy, (k, 3) in m; None if they do not fit.

    With ȳ and Δȳ the means, and Y and D the deviations from them, (tr(YᵀY) - YᵀY) θ = Σ Dᵢ × Yᵢ and p = ȳ × θ - Δȳ.
    """
    middle, mean = places.mean(axis=0), moved.mean(axis=0)
    Y, D = places - middle, moved - mean
    inertia, products = Y.T @ Y, Y.T @ D
    inertia = float(inertia.trace()) * np.eye(3) - inertia
    size = 0.5 * float(inertia.trace())
    # Two eigenvalues are about `size`, and the third is small if the points are on a line.
    if not float(np.linalg.det(inertia)) >= _SPREAD**2 * size**2 > 0.0:
        return None
    torque = np.array(
        [products[2, 1] - products[1, 2], products[0, 2] - products[2, 0], products[1, 0] - products[0, 1]]
    )
    turn = np.linalg.solve(inertia, torque)
    left, size = sum_of_squares(D) - float(torque @ turn), sum_of_squares(moved)
    if not left <= _RIGID * size:
        return None
    return np.array([turn, cross(middle, turn) - mean])
