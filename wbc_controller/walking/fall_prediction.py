"""Prediction of an unavoidable fall, latched."""

import math

from wbc_controller.walking.fall_kernels import PERSISTS

_PERIOD = 0.012  # time between predictions of a fall, s


class FallPrediction:
    """Prediction of a fall, latched after it has persisted.

    Attributes:
        sentence: about an unavoidable fall; empty without one.
    """

    STATE_FIELDS = ("sentence", "_watched", "_captured")

    def __init__(self) -> None:
        self.sentence = ""
        self._watched = -math.inf  # time of the last prediction, s
        self._captured = math.inf  # last time at which no fall was predicted, s

    def is_due(self, time: float) -> bool:
        """Return whether a prediction is due at the time of a state, s; if so, the next one is due later."""
        if 0.0 <= time - self._watched < _PERIOD:
            return False
        self._watched = time
        return True

    def clear(self, time: float) -> None:
        """Note that no fall is predicted at a time, s."""
        self._captured = time

    def compare(self, time: float, distance: float, most: float, support: str) -> None:
        """Predict a fall if a distance of the DCM from a support exceeds the largest one, m, for some time."""
        if not distance > most or time < self._captured:
            self.clear(time)
        elif time - self._captured > PERSISTS:
            self.sentence = (
                f"a fall is unavoidable: the capture point is {distance:.2f} m away from {support} (limit {most:.2f} m)"
            )
