"""Speed relative to real time."""

import logging
from collections.abc import Callable

_WINDOW = 5.0  # averaging time, s of wall time
_LOW, _ENOUGH = 0.9, 0.95  # shares of the requested speed with hysteresis: too low, sufficient again

_log = logging.getLogger(__name__)


class Speed:
    """Comparison of simulated time and wall time; `factor` is the requested speed."""

    def __init__(self, factor: float, clock: Callable[[], float], simulated: float) -> None:
        """Start the measurement at a simulated time, s."""
        self._factor, self._clock = factor, clock
        self._low = False
        self._began = self._since = clock()
        self._first = self._simulated = simulated  # simulated time at the start, and of the window, s

    def check(self, simulated: float) -> None:
        """Log a change of the speed; called in each period."""
        now = self._clock()
        if now - self._since < _WINDOW:
            return
        speed = (simulated - self._simulated) / (now - self._since)
        self._since, self._simulated = now, simulated
        if speed < _LOW * self._factor and not self._low:
            self._low = True
            _log.warning(
                "the simulation runs at %.0f %% of real time instead of %.0f %%: this computer is too slow or busy, or"
                " a patient robot waits for its controller; use a smaller real_time_factor, or lockstep",
                100.0 * speed,
                100.0 * self._factor,
            )
        elif speed >= _ENOUGH * self._factor and self._low:
            self._low = False
            _log.info("the simulation runs at %.0f %% of real time again", 100.0 * speed)

    def mean(self, simulated: float) -> float:
        """Return the mean speed as a share of real time."""
        return (simulated - self._first) / max(self._clock() - self._began, 1.0e-9)
