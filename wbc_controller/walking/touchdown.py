"""Touchdown by a contact sensor or by motion."""

from wbc_controller.records import Array

#: Share of the planned swing from which on a touchdown counts.
COUNTS = 0.6
#: Share of the reference's downward speed below which the ground has stopped the foot.
_STOPPED = 0.5
#: Downward speed of the reference from which on the motion is compared, m/s; at the end of the swing it is 0.1 m/s.
_DESCENDING = 0.07
#: Largest speed of a foot that the ground has stopped, m/s.
_SLOW = 0.2
#: Time after the planned touchdown at which the foot counts as landed at the latest, s.
LATEST = 0.15


def lands(share: float, late: float, wanted: float, velocity: Array, touching: bool | None) -> bool:
    """Return whether the foot has touched the ground.

    Args:
        share: elapsed share of the planned swing.
        late: time after the planned touchdown, s; negative before.
        wanted: vertical velocity of the reference, m/s.
        velocity: of the centre of the sole, (3,) in m/s.
        touching: state of the contact sensor; None without one.
    """
    if share < COUNTS:
        return False
    if late >= LATEST:
        return True
    if touching:
        return True
    stopped = wanted <= -_DESCENDING and velocity[2] > _STOPPED * wanted
    rebounds = velocity[2] > 0.0
    return bool(stopped and (rebounds or velocity.dot(velocity) < _SLOW * _SLOW))
