"""Divergent component of motion (DCM) of the linear inverted pendulum.

The DCM ξ = c + ċ / ω of a centre of mass c at a constant height z above the ground, with ω = √(g / z), moves away from
the centre of pressure p: ξ̇ = ω (ξ - p). c follows ξ by itself. All points are complex numbers, x + i y in m.

Source: Englsberger, Ott and Albu-Schäffer, IEEE Transactions on Robotics 31, 2015.
"""

from __future__ import annotations

import math

from wbc_controller.compilation import compiled, part


def natural_frequency(height: float, gravity: float) -> float:
    """Return ω = √(g / z) in 1/s for a height z in m and gravity g in m/s²."""
    return math.sqrt(gravity / height)


@compiled
def later(dcm: complex, pressure: complex, omega: float, time: float) -> complex:
    """Return the DCM after a time in s with a constant centre of pressure: p + (ξ - p) e^{ωt}."""
    return pressure + (dcm - pressure) * math.exp(omega * time)


@compiled
def before(dcm: complex, pressure: complex, omega: float, time: float, push: complex) -> complex:
    """Return the DCM a time in s earlier: the inverse of `later`, and of a `push` at the end by the swing foot, m."""
    return later(dcm - push, pressure, omega, -time)


@compiled
def transferred(dcm: complex, start: complex, end: complex, duration: float, omega: float, time: float) -> complex:
    """Return the DCM after a time t while the centre of pressure moves from p₀ to p₁ at a constant velocity.

    With `dcm` ξ₀, the duration T, s, and ṗ = (p₁ - p₀) / T: ξ(t) = p₀ + ṗ t + ṗ / ω + (ξ₀ - p₀ - ṗ / ω) e^{ωt}.
    """
    speed = (end - start) / duration
    return start + speed * (time + 1.0 / omega) + (dcm - start - speed / omega) * math.exp(omega * time)


def leading(dcm: complex, start: complex, end: complex, duration: float, omega: float) -> complex:
    """Return ξ₀ for a DCM at the end of a double support, T after ξ₀; arguments of `transferred`."""
    return transferred(dcm, end, 2.0 * end - start, duration, omega, -duration)


@part
def _factors(omega: float, single: float, double: float) -> tuple[float, float, float]:
    E, G = math.exp(omega * double), math.exp(omega * single)
    return E, G, E - (E - 1.0) / (omega * double) if double > 0.0 else 0.0


@compiled
def periodic_offset(
    progress: complex, width: complex, omega: float, single: float, double: float, push: float
) -> complex:
    """Return the DCM at touchdown, relative to the new foot, of the gait that repeats a step: b.

    The step of the foot is s = progress + width; the next one is progress - width. With E = e^{ωT_d}, G = e^{ωT_s} and
    κ = E - (E - 1) / (ωT_d), one step maps the offset to b' = (b E + κ s) G + ρ (s + s') - s'. Periodic are

        b = s (1 - κ G - 2 ρ) / (E G - 1)     of the part of s that repeats,
        b = -s (1 + κ G) / (E G + 1)    of the part that alternates.

    Args:
        progress, width: parts of the step from the stance foot to the new one that repeat and alternate, m.
        single, double: durations T_s and T_d of the supports, s; in the double one, which may take 0 s, the centre of
            pressure moves linearly.
        push: ρ, change of the DCM at the end of the step by a swing foot that moves by 1 m.
    """
    E, G, kappa = _factors(omega, single, double)
    return progress * (1.0 - kappa * G - 2.0 * push) / (E * G - 1.0) - width * (1.0 + kappa * G) / (E * G + 1.0)


@compiled
def previous_offset(
    offset: complex, step: complex, following: complex, omega: float, single: float, double: float, push: float
) -> complex:
    """Return the offset b of a step s that leads to the offset b' after the following step s', x + i y in m each.

    With the factors of `periodic_offset`, b = ((b' + s' - ρ (s + s')) / G - κ s) / E.
    """
    E, G, kappa = _factors(omega, single, double)
    return ((offset + following - push * (step + following)) / G - kappa * step) / E
