"""Prediction of a fall.

While the centre of pressure is at p, the point of the support next to the DCM ξ, the DCM moves within the time t of
the fastest step to ξ_t = p + (ξ - p) e^{ωt}. A foot can then be placed within the reach of the leg. From there, steps
of the length L and the nominal step time T stop the DCM if it is at most

    L e^{-ωT} + L e^{-2ωT} + … = L / (e^{ωT} - 1)

away from the foot. Otherwise a fall is unavoidable. Without steps, it is unavoidable beyond a distance from the support
that no motion of the arms and the trunk compensates.

Source: Koolen et al., International Journal of Robotics Research 31, 2012.
"""

from __future__ import annotations

import cmath
import math

from wbc_controller.compilation import compiled
from wbc_controller.walking.footsteps_kernels import StepSizes
from wbc_controller.walking.references_kernels import clipped, nearest_in_support

#: Time for which the DCM must be out of reach, s: an impact of a foot changes the velocity for a few cycles.
PERSISTS = 0.02
STANDING = 0.22  # largest distance of the DCM from the support of a standing robot, as a share of its height
MARGIN = 0.05  # margin of the reach, m, for the errors of the estimate and of the model


@compiled
def nearest_support(
    dcm: complex, first: complex, second: complex, heading: float, length: float, width: float
) -> complex:
    """Return a point p near the DCM in the support of one or two soles, on two soles up to one half length outside it.

    Arguments as of `nearest_in_support`: the DCM ξ, the centres of the soles, heading and half sides of a sole.
    """
    way = second - first
    if way == 0.0:
        return nearest_in_support(dcm, first, second, heading, length, width)
    share = ((dcm - first) * way.conjugate()).real / abs(way) ** 2
    between = first + max(0.0, min(1.0, share)) * way
    apart = abs(dcm - between)
    return dcm if apart <= length else between + (dcm - between) * (length / apart)


@compiled
def missed(
    dcm: complex, first: complex, first_heading: float, second: complex, second_heading: float, length: float,
    width: float, sizes: StepSizes, omega: float, time: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the distance from the DCM to the nearest foothold at the earliest touchdown, and the largest one, m.

    Crossing feet are allowed: a late alarm is better than a false one. The earliest touchdown is after the time t, s.
    """
    support = nearest_support(dcm, first, second, first_heading, length, width)
    end = support + (dcm - support) * math.exp(omega * time)
    distance = math.inf
    for place, heading in ((first, first_heading), (second, second_heading)):
        local = (end - place) / cmath.rect(1.0, heading)
        distance = min(distance, abs(local - clipped(local, sizes.length, sizes.greatest_width)))
    longest, step_time = max(sizes.length, sizes.greatest_width), sizes.single + sizes.double
    return distance, longest / math.expm1(omega * step_time) + MARGIN
