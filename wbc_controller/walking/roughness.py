"""Unevenness and roughness of the ground, from the heights of the last footholds."""

from wbc_controller.walking.swing_kernels import TOUCHDOWN_SPEED

_KEPT = 0.8  # share of the unevenness kept per foothold
#: Additional touchdown speed per unevenness, 1/s, and largest speed, m/s: a slow foot lands late on lower ground.
_FASTER, _FASTEST = 20.0, 0.3
#: Largest error of a height on even ground, and least one on rough ground, m, and share of the roughness kept per
#: foothold.
_EVEN, _ROUGH, _REMEMBERED = 0.003, 0.007, 0.93
#: Distance of the planned touchdown below rough ground, m: the centre of pressure can wait after an early touchdown,
#: but the DCM moves away while a foot is late.
_BELOW = 0.02


class Roughness:
    """Memory of the errors of expected heights.

    Attributes:
        unevenness: largest error of the last footholds, m.
        share: roughness of the ground, from 0 (even) to 1.
    """

    STATE_FIELDS = ("unevenness", "share")

    def __init__(self) -> None:
        self.unevenness = self.share = 0.0

    def add(self, error: float, measures: bool) -> None:
        """Add the error of the height of a foothold, m; `measures`: it changes the roughness."""
        self.unevenness = max(error, _KEPT * self.unevenness)
        if measures:
            rough = max(0.0, min((error - _EVEN) / (_ROUGH - _EVEN), 1.0))
            self.share = max(rough, _REMEMBERED * self.share)

    @property
    def touchdown_speed(self) -> float:
        """Downward speed of the swing foot at touchdown, m/s."""
        return min(TOUCHDOWN_SPEED + _FASTER * self.unevenness, _FASTEST)


def aim_below(roughness: float) -> float:
    """Return the distance of the planned touchdown below ground of a roughness from 0 to 1, m."""
    return _BELOW * roughness
