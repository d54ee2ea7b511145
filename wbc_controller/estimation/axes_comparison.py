"""Comparison of two measurements of one motion: errors of axes and units that explain their difference.

Two sensors measure a motion as a and b = C a, both (3,) in the same axes. C = 1 if both are right. Wrong axes or units
give one of a few other matrices: a rotation about one axis, a permutation of axes with signs, the rotation to the
world's axes, or the factor from rad to degrees. The means over the last second

    E(C) = ⟨|b - C a|²⟩ = ⟨|b|²⟩ - 2 tr(Cᵀ ⟨b aᵀ⟩) + tr(C ⟨a aᵀ⟩ Cᵀ)

decide: E(1) is the contradiction, and another C explains it if E(C) is a small share of E(1). A contradiction without
an explanation has another cause, such as a slipping foot.
"""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np

from wbc_controller.records import Array

#: Time constant of the means, s.
_MEAN = 1.0
#: √E(1) from which a contradiction counts, rad or m, and the share of it that counts if the sensor is wrong anyway.
_LIMIT, _SURE = 0.002, 0.1
#: Largest share of a contradiction that an explanation leaves over, and that a suspicion does.
_LEFT_OVER, _SUSPECTED = 0.05, 0.25
#: Largest difference of explanations that explain alike, as a share of the contradiction.
_ALIKE = 0.01
#: RMS of a along its least axis from which agreement is final, rad or m.
_ALL_AXES = 0.006
#: Factor from rad to degrees.
_DEGREES = math.degrees(1.0)
#: Weights of ⟨c cᵀ⟩ with c = (a, b) in E(1), (6, 6).
_CONTRADICTION = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
#: All permutations of axes with all signs, row by row, (48, 9).
_SIGNED = np.array(
    [
        (np.array(signs)[:, None] * np.eye(3)[list(order)]).ravel()
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
)


class AxesComparison:
    """Means of the products of a and b, for turns and, if measured, for displacements."""

    def __init__(self, *, moves: bool) -> None:
        """Start without data; `moves` adds displacements."""
        self._means = np.zeros((2 if moves else 1, 6, 6))  # ⟨c cᵀ⟩ with c = (a, b), of turns and displacements
        self._suspicion: str | None = None  # the last sentence on deg/s, which noise and slips may hide

    @property
    def agreed(self) -> bool:
        """True after motion along all axes without a contradiction: later contradictions have other causes."""
        motion = self._means[:, :3, :3]
        if not (np.trace(motion, axis1=1, axis2=2) > 3.0 * _ALL_AXES**2).all():
            return False
        small = (self._means * _CONTRADICTION).sum(axis=(1, 2)) < _LIMIT**2
        return bool(small.all() and np.linalg.eigvalsh(motion).min() > _ALL_AXES**2)

    @property
    def turns_agree(self) -> bool:
        """True if there was enough turning for a contradiction, and there is none."""
        motion = float(self._means[0, :3, :3].trace())
        contradiction = float((self._means[0] * _CONTRADICTION).sum())
        return motion > _LIMIT**2 and contradiction <= _LEFT_OVER * motion

    def update(self, elapsed: float, a: Array, b: Array, world: Array | None, *, at_once: bool = False) -> str | None:
        """Take a and b after a time, s; return a sentence on a contradiction that an error explains, or None.

        Args:
            a: turn and displacement by one sensor, (n, 3) in rad and m.
            b: likewise by the sensor that may have wrong axes or units.
            world: rotation to the world, (3, 3), if b could be in its axes.
            at_once: whether the sensor is known to be wrong: then a small contradiction and a suspicion count too.
        """
        c = np.concatenate([a, b], axis=1)
        self._means += (1.0 - math.exp(-elapsed / _MEAN)) * (c[:, :, None] * c[:, None, :] - self._means)
        contradictions = (self._means * _CONTRADICTION).sum(axis=(1, 2))
        limit = (_SURE * _LIMIT if at_once else _LIMIT) ** 2
        for i, contradiction in enumerate(contradictions.tolist()):
            if contradiction < limit:
                continue
            causes = self._causes(i, world)
            least = min(left for left, _ in causes)
            if least > _SUSPECTED * contradiction:
                continue
            alike = [cause for left, cause in causes if left <= least + _ALIKE * contradiction]
            motion, unit = ("a turn", "rad") if i == 0 else ("a displacement", "m")
            sentence = (
                f"{motion} of {vector_text(a[i])} {unit} is measured as {vector_text(b[i])}, "
                f"as if {' or '.join(alike[:2])}"
            )
            if least <= _LEFT_OVER * contradiction:
                return sentence
            if i == 0 and causes[0][0] == least:
                self._suspicion = sentence
        return self._suspicion if at_once else None

    def _causes(self, kind: int, world: Array | None) -> list[tuple[float, str]]:
        """Return E(C) and the name of each error, the more usual ones first; of turns (0) or displacements (1).

        E(C) is ⟨|a|²⟩ + ⟨|b|²⟩ - 2 tr(Cᵀ ⟨b aᵀ⟩) for an orthogonal C.
        """
        means, causes = self._means[kind], []
        S, aa, bb = means[3:, :3], float(means[:3, :3].trace()), float(means[3:, 3:].trace())
        if kind == 0:
            left = bb - 2.0 * _DEGREES * float(S.trace()) + _DEGREES**2 * aa
            causes.append((left, "angular velocities were in deg/s instead of rad/s"))
        if world is not None:
            cause = "the twist were in the axes of the world, not of child_frame_id"
            causes.append((aa + bb - 2.0 * float(np.vdot(world, S)), cause))
        for k in (2, 0, 1):  # the best rotation about one axis
            i, j = (k + 1) % 3, (k + 2) % 3
            sine, cosine = float(S[j, i] - S[i, j]), float(S[i, i] + S[j, j])
            angle = -round(math.degrees(math.atan2(sine, cosine)))
            left = aa + bb - 2.0 * (float(S[k, k]) + math.hypot(sine, cosine))
            causes.append((left, f"the axes were rotated by {angle}° about {'xyz'[k]}"))
        fits = _SIGNED @ S.ravel()
        best = int(fits.argmax())
        rows = _SIGNED[best].reshape(3, 3)
        axes = [("-" if row.min() < 0.0 else "") + "xyz"[int(np.abs(row).argmax())] for row in rows]
        causes.append((aa + bb - 2.0 * float(fits[best]), f"the axes x, y, z were {', '.join(axes)}"))
        return causes


def vector_text(values: Array) -> str:
    """Return the values of a vector, (3,), with three digits."""
    return "[" + ", ".join(f"{value:.3g}" for value in values + 0.0) + "]"
