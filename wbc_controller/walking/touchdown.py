"""Touchdown by a contact sensor or by motion."""

import math

from wbc_controller.records import Array
from wbc_controller.walking.feet import Sole
from wbc_controller.walking.swing_kernels import Landing
from wbc_controller.walking.terrain import aim_below

COUNTS = 0.6  # least share of the planned swing for a touchdown
_STOPPED = 0.5  # share of the reference's downward speed below which the ground has stopped the foot
_DESCENDING = 0.07  # least downward speed of the reference for the comparison of the motion, m/s
#: Largest speed of a foot stopped by the ground: m/s; share of the horizontal speed of its reference; after the planned
#: touchdown, m/s. Soles of fast steps slide.
_SLOW, _SLOWED, _SLIDES = 0.2, 0.5, 1.0
#: Least horizontal angular velocity of a sole turned by an edge, rad/s, and least excess of its vertical velocity over
#: that of the reference, m/s; largest speed and vertical velocity of its centre, m/s: an obstacle throws a foot up.
_TURNED, _TURNED_BEHIND, _TURNED_SPEED, _TURNED_RISE = 0.8, 0.05, 0.5, 0.1
LATEST = 0.15  # longest time after the planned touchdown until the foot counts as landed, s
_LOW = 0.5  # height of a sole and its reference below which a touchdown counts at once, as a share of the clearance
#: Height above the expected ground, m, from which a sole must rest for a time, s; time and largest speed, m/s, for a
#: sole that is not low: limited torques stop it in the air.
_HIGHER, _RESTS, _RESTS_HIGH, _AT_REST = 0.01, 0.02, 0.04, 0.05


class SoleTouchdown:
    """Touchdown of a swinging sole, which may rest on a stone above the planned height."""

    STATE_FIELDS = ("_moved",)

    def __init__(self) -> None:
        self._moved = -math.inf  # last time at which the sole moved, s

    def update(
        self, time: float, elapsed: float, swing: Array, landing: Landing, clearance: float, sole: Sole,
        touching: bool | None,
    ) -> bool:  # fmt: skip
        """Return whether the sole has landed at a time, s, `elapsed` since the lift-off; `touching` as of `lands`.

        `swing` is the motion of the reference, (3, 4) (`swing_kernels`), `clearance` its height above the ground, m.
        """
        late = elapsed - landing.time
        if elapsed < COUNTS * landing.time:
            self._moved = time
            return False
        wanted, higher = swing.item(1, 2), sole.height - landing.height
        low = max(swing.item(0, 2) - landing.height, higher) < _LOW * clearance
        slow = _SLIDES if late > 0.0 else max(_SLOW, _SLOWED * math.hypot(swing.item(1, 0), swing.item(1, 1)))
        stopped = (low or late >= LATEST or sole.speed < _AT_REST) and lands(
            late, wanted, landing.speed, sole.rise, sole.speed, touching if low else None, slow
        )
        if not stopped:
            self._moved = time
        expected = higher < aim_below(landing.roughness) + _HIGHER
        counts = stopped and (late >= LATEST or (low and (touching or expected)))
        rested = time - self._moved > (_RESTS if low else _RESTS_HIGH)
        tipped = tips(wanted, sole.rise, sole.speed, sole.turning)
        return bool(counts or rested or tipped)


def lands(
    late: float, wanted: float, landing: float, rise: float, speed: float, touching: bool | None, slow: float = _SLOW
) -> bool:
    """Return whether the ground has stopped the foot, after the share `COUNTS` of the swing.

    Args:
        late: time after the planned touchdown, s; negative before.
        wanted, landing: vertical velocity of the reference, and its downward speed at the planned touchdown, m/s.
        rise, speed: vertical velocity and speed of the centre of the sole, m/s.
        touching: state of the contact sensor; None to judge by the motion alone.
        slow: largest speed of a stopped foot, m/s.
    """
    if late >= LATEST or touching:
        return True
    return wanted <= -_DESCENDING and rise > _STOPPED * max(wanted, -landing) and speed < slow


def tips(wanted: float, rise: float, speed: float, turning: float) -> bool:
    """Return whether the ground turns a descending sole: one of its edges has landed.

    `turning`: horizontal angular velocity, rad/s; others as of `lands`.
    """
    turned = turning > _TURNED and speed < _TURNED_SPEED and rise < _TURNED_RISE
    return turned and wanted <= -_DESCENDING and rise > wanted + _TURNED_BEHIND


def rebounds(wanted: float, rise: float) -> bool:
    """Return whether a point foot moves up again while its reference descends; arguments of `lands`.

    A sole does not rebound: if it moves up, it follows the reference of a short step late.
    """
    return wanted <= -_DESCENDING and rise > 0.0
