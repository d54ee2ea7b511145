"""Prediction of a fall.

While the centre of pressure is at p, the point of the support next to the DCM ξ, the DCM moves within the time t of
the fastest step to ξ_t = p + (ξ - p) e^{ωt}. A foot can then be placed within the reach of the leg. From there, steps
of the length L and the nominal step time T stop the DCM if it is at most

    L e^{-ωT} + L e^{-2ωT} + … = L / (e^{ωT} - 1)

away from the foot. Otherwise a fall is unavoidable. Without steps, it is unavoidable beyond a distance from the support
that no motion of the arms and the trunk compensates.

Source: Koolen, de Boer, Rebula, Goswami and Pratt, Capturability-based analysis and control of legged locomotion, part
1, International Journal of Robotics Research 31, 2012.
"""

import math
from collections.abc import Sequence

from wbc_controller.walking.gait import Gait

#: Time for which the DCM must be out of reach, s: an impact of a foot changes the velocity for a few cycles.
PERSISTS = 0.02
#: Largest distance of the DCM from the support of a standing robot, as a share of its height.
STANDING = 0.22
#: Margin of the reach, m, for the errors of the estimate and of the model.
MARGIN = 0.05


def nearest_support(dcm: complex, soles: Sequence[tuple[complex, complex]], half: tuple[float, float]) -> complex:
    """Return a point p near the DCM in the support of one or two soles, on two soles up to one half length outside it.

    Args:
        dcm: ξ, x + i y in m.
        soles: their centres, and headings as e^{iψ}.
        half: half length and half width of a sole, m.
    """
    (start, axes), (end, _) = soles[0], soles[-1]
    way = end - start
    if way == 0.0:
        return start + _clipped((dcm - start) / axes, half) * axes
    share = ((dcm - start) * way.conjugate()).real / abs(way) ** 2
    between = start + max(0.0, min(1.0, share)) * way
    apart = abs(dcm - between)
    return dcm if apart <= half[0] else between + (dcm - between) * (half[0] / apart)


def missed(
    dcm: complex, soles: Sequence[tuple[complex, complex]], half: tuple[float, float], gait: Gait, omega: float,
    time: float,
) -> float:  # fmt: skip
    """Return the distance from the DCM to the nearest foothold at the earliest touchdown, m; other arguments as above.

    Crossing feet are allowed: a late alarm is better than a false one.

    Args:
        omega: ω, 1/s.
        time: until the earliest touchdown t, s.
    """
    support = nearest_support(dcm, soles, half)
    end = support + (dcm - support) * math.exp(omega * time)
    reach = gait.length, gait.greatest_width
    return min(abs((end - place) / axes - _clipped((end - place) / axes, reach)) for place, axes in soles)


def captured_by_steps(gait: Gait, omega: float, step_time: float) -> float:
    """Return the largest distance of the DCM from a foot, m, for a capture by further steps of the time T, s."""
    return max(gait.length, gait.greatest_width) / math.expm1(omega * step_time)


def _clipped(point: complex, half: tuple[float, float]) -> complex:
    return complex(max(-half[0], min(half[0], point.real)), max(-half[1], min(half[1], point.imag)))
