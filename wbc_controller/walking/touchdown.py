"""Touchdown by a contact sensor or by motion."""

#: Least share of the planned swing for a touchdown.
COUNTS = 0.6
#: Share of the reference's downward speed below which the ground has stopped the foot.
_STOPPED = 0.5
#: Least downward speed of the reference for the comparison of the motion, m/s.
_DESCENDING = 0.07
#: Largest speed of a foot stopped by the ground, m/s.
_SLOW = 0.2
#: Least horizontal angular velocity of a sole turned by an edge, rad/s, and largest speed and vertical velocity of its
#: centre, m/s: an obstacle throws a foot up.
_TURNED, _TURNED_SPEED, _TURNED_RISE = 1.5, 0.4, 0.1
#: Longest time after the planned touchdown until the foot counts as landed, s.
LATEST = 0.15


def lands(
    share: float,
    late: float,
    wanted: float,
    landing: float,
    rise: float,
    speed: float,
    touching: bool | None,
) -> bool:
    """Return whether the ground has stopped the foot.

    Args:
        share: elapsed share of the planned swing.
        late: time after the planned touchdown, s; negative before.
        wanted, landing: vertical velocity of the reference, and its downward speed at the planned touchdown, m/s.
        rise, speed: vertical velocity and speed of the centre of the sole, m/s.
        touching: state of the contact sensor; None to judge by the motion alone.
    """
    if share < COUNTS:
        return False
    if late >= LATEST or touching:
        return True
    return _is_stopped(wanted, landing, rise) and speed < _SLOW


def tips(share: float, wanted: float, landing: float, rise: float, speed: float, turning: float) -> bool:
    """Return whether an edge turns a descending sole; the swing would tip it.

    `turning`: horizontal angular velocity, rad/s; others as of `lands`.
    """
    turned = turning > _TURNED and speed < _TURNED_SPEED and rise < _TURNED_RISE
    return share >= COUNTS and turned and _is_stopped(wanted, landing, rise)


def _is_stopped(wanted: float, landing: float, rise: float) -> bool:
    return wanted <= -_DESCENDING and rise > _STOPPED * max(wanted, -landing)


def rebounds(wanted: float, rise: float) -> bool:
    """Return whether a point foot moves up again while its reference descends; arguments of `lands`.

    A sole does not rebound: if it moves up, it follows the reference of a short step late.
    """
    return wanted <= -_DESCENDING and rise > 0.0
