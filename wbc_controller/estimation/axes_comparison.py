"""Axis and unit errors between two measurements.

Two sensors measure a and b = C a, (3,). C is 1, or with an error a rotation about one axis, a signed permutation, the
rotation to the world, or the factor from rad to degrees. C explains the contradiction E(1) if E(C) is a small share of
it, with means ⟨ ⟩ over a second

    E(C) = ⟨|b - C a|²⟩ = ⟨|b|²⟩ - 2 tr(Cᵀ ⟨b aᵀ⟩) + tr(C ⟨a aᵀ⟩ Cᵀ)

Wrong axes of a pose affect rotations and displacements, tipping soles only rotations: C has to explain a weighted sum.
"""

import math
from itertools import permutations, product

import numpy as np

from wbc_controller.records import Array

_MEAN = 1.0  # time constant of the means, s
#: Smallest √E(1) of a contradiction, rad or m, and its factor for sensors known to be wrong.
_LIMIT, _KNOWN_WRONG = 0.002, 0.1
_EXPLAINED, _SUSPECTED = 0.05, 0.25  # largest E(C) / E(1) of an explanation, and of a suspicion
_ALIKE = 0.01  # largest difference of equally good explanations, as a share of E(1)
_ALL_AXES = 0.006  # RMS of a along its smallest axis for a final agreement, rad or m
_LEAST_ANGLE = 20  # smallest named rotation, degrees: a sole that twists causes smaller ones
_DEGREES = math.degrees(1.0)  # factor from rad to degrees
_UNIT = "angular velocities were in deg/s instead of rad/s"  # cause of a rotation in degrees
_CONTRADICTION = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))  # weights of ⟨c cᵀ⟩ with c = (a, b) in E(1), (6, 6)
#: Signed permutations of axes, row by row, (48, 9).
_SIGNED = np.array(
    [
        (np.array(signs)[:, None] * np.eye(3)[list(order)]).ravel()
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
)


class AxesComparison:
    """Means of the products of a and b, of rotations and optionally of displacements."""

    def __init__(self, *, with_displacements: bool) -> None:
        kinds = 2 if with_displacements else 1  # turns and displacements
        self._means = np.zeros((kinds, 6, 6))  # ⟨c cᵀ⟩ with c = (a, b)
        self._last = np.zeros((kinds, 3)), np.zeros((kinds, 3))  # a and b
        self._lever = 0.0
        self._suspicion: str | None = None  # last message on deg/s; noise and slips may hide this error

    @property
    def agreed(self) -> bool:
        """True after motion along all axes without contradiction; later contradictions have other causes."""
        motion = self._means[:, :3, :3]
        if not motion.diagonal(axis1=1, axis2=2).min() > _ALL_AXES**2:  # fast
            return False
        small = (self._means * _CONTRADICTION).sum(axis=(1, 2)) < _LIMIT**2
        return bool(small.all() and np.linalg.eigvalsh(motion).min() > _ALL_AXES**2)

    @property
    def turns_agree(self) -> bool:
        """True if sufficient rotations agree."""
        motion = float(self._means[0, :3, :3].trace())
        contradiction = float((self._means[0] * _CONTRADICTION).sum())
        return motion > _LIMIT**2 and contradiction <= _EXPLAINED * motion

    def update(
        self, elapsed: float, a: Array, b: Array, world: Array | None, *, known_wrong: bool = False, lever: float = 0.0
    ) -> str | None:
        """Average a and b over a step, s; return a message on an explained contradiction, or None.

        Args:
            a, b: rotation and displacement of the reference and of the tested sensor, (n, 3) in rad and m.
            world: rotation from sensor axes to the world, (3, 3), or None.
            known_wrong: True lowers the limits.
            lever: distance at which a rotation counts as much as a displacement, m, to explain both; 0: each alone.
        """
        self._lever = lever
        c = np.concatenate([a, b], axis=1)
        self._means += (1.0 - math.exp(-elapsed / _MEAN)) * (c[:, :, None] * c[:, None, :] - self._means)
        self._last = a, b
        return self.explanation(world, known_wrong=known_wrong)

    def explanation(self, world: Array | None, *, known_wrong: bool) -> str | None:
        """Return the message of `update` without new measurements."""
        a, b = self._last
        limit = (_KNOWN_WRONG * _LIMIT if known_wrong else _LIMIT) ** 2
        for i, own in enumerate((self._means * _CONTRADICTION).sum(axis=(1, 2)).tolist()):
            if own < limit:
                continue
            means = self._means[i] if self._lever == 0.0 else self._means[0] + self._means[1] / self._lever**2
            contradiction = float((means * _CONTRADICTION).sum())
            causes = _causes(means, world)
            if i == 0:  # the unit of the rotations alone
                causes.insert(0, (_in_degrees(self._means[0]) + contradiction - own, _UNIT))
            least = min(left for left, _ in causes)
            if least > _SUSPECTED * contradiction:
                continue
            equal = [cause for left, cause in causes if left <= least + _ALIKE * contradiction]
            motion, unit = (("a turn", "rad"), ("a displacement", "m"))[i]
            errors, seen = " or ".join(equal[:2]), vector_text(b[i])
            sentence = f"{motion} of {vector_text(a[i])} {unit} is measured as {seen}, as if {errors}"
            if least <= _EXPLAINED * contradiction:
                return sentence
            if i == 0 and causes[0][0] == least:
                self._suspicion = sentence
        return self._suspicion if known_wrong else None


def _in_degrees(means: Array) -> float:
    """Return E(C) with the factor C from rad to degrees."""
    a, b = float(means[:3, :3].trace()), float(means[3:, 3:].trace())
    return b - 2.0 * _DEGREES * float(means[3:, :3].trace()) + _DEGREES**2 * a


def _causes(means: Array, world: Array | None) -> list[tuple[float, str]]:
    """Return E(C) = ⟨|a|²⟩ + ⟨|b|²⟩ - 2 tr(Cᵀ ⟨b aᵀ⟩) and the name of each error of the axes, from ⟨c cᵀ⟩, (6, 6)."""
    causes = []
    S, size = means[3:, :3], float(means.trace())
    if world is not None:
        cause = "the twist were in the axes of the world, not of child_frame_id"
        causes.append((size - 2.0 * float(np.vdot(world, S)), cause))
    for k in (2, 0, 1):  # the best rotation about one axis
        i, j = (k + 1) % 3, (k + 2) % 3
        sine, cosine = float(S[j, i] - S[i, j]), float(S[i, i] + S[j, j])
        angle = -round(math.degrees(math.atan2(sine, cosine)))
        if abs(angle) >= _LEAST_ANGLE:
            left = size - 2.0 * (float(S[k, k]) + math.hypot(sine, cosine))
            causes.append((left, f"the axes were rotated by {angle}° about {'xyz'[k]}"))
    fits = _SIGNED @ S.ravel()
    best = int(fits.argmax())
    rows = _SIGNED[best].reshape(3, 3)
    axes = [("-" if row.min() < 0.0 else "") + "xyz"[int(np.abs(row).argmax())] for row in rows]
    causes.append((size - 2.0 * float(fits[best]), f"the axes x, y, z were {', '.join(axes)}"))
    return causes


def vector_text(values: Array) -> str:
    """Return the values of a vector, (3,), with three digits."""
    return "[" + ", ".join(f"{value:.3g}" for value in values + 0.0) + "]"
