"""Kernels for the nominal step of a velocity."""

from __future__ import annotations

import cmath

from wbc_controller.compilation import Struct, compiled
from wbc_controller.walking.pendulum_kernels import periodic_offset
from wbc_controller.walking.swing_kernels import integrate_axis

_MARGIN = 0.01  # margin of the nominal width over the smallest one, m


class StepSizes(Struct):
    """Sizes of a biped's steps; the fields of `Gait` with these names."""

    single: float  # nominal duration of the single support, s
    double: float  # duration of the double support, s
    width: float  # nominal distance between the feet, m
    least_width: float  # smallest distance between the feet, m
    greatest_width: float  # largest distance between the feet, m
    length: float  # longest step forward or backward, m
    sole_length: float  # length of a sole, m
    sole_width: float  # width of a sole, m
    reaction: float  # μ


@compiled
def swing_push(reaction: float, single: float, omega: float) -> float:
    """Return ρ, the change of the DCM at touchdown by a swing foot that moves by 1 m from rest to rest."""
    return reaction / omega * integrate_axis(0.0, 0.0, 0.0, 1.0, single, omega)


@compiled
def periodic_step(
    velocity: complex, turning: float, duration: float, stance: complex, heading: float, side: int, omega: float,
    sizes: StepSizes,
) -> tuple[complex, float, complex]:  # fmt: skip
    """Return the fields of the `NominalStep` with a single support of a duration, s.

    The middle between the feet moves by velocity times step time in the mean heading. Sideways steps widen the stance,
    so that the inward step keeps the smallest distance between the feet. The other arguments are fields of `Velocity`
    and `Stance`.
    """
    single, double = sizes.single, sizes.double
    progress, turn = velocity * (duration + double), turning * (duration + double)
    wide = max(sizes.width, sizes.least_width + _MARGIN + abs(progress.imag)) * side * 1j
    before, after = cmath.rect(1.0, heading), cmath.rect(1.0, heading + turn)
    middle = cmath.rect(1.0, heading + 0.5 * turn)
    place = stance + 0.5 * wide * before + progress * middle + 0.5 * wide * after
    push = swing_push(sizes.reaction, single, omega)
    offset = periodic_offset(velocity * (single + double), wide, omega, single, double, push) * after
    return place, heading + turn, offset
