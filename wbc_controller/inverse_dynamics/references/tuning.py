"""Ramps between sets of gains and limits."""

from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.inverse_dynamics.references.trajectories import Ramp
from wbc_controller.records import Tuning

_SCALARS = ("position_margin", "position_horizon", "velocity_scale", "acceleration", "torque_rate")


@dataclass(frozen=True, slots=True)
class TuningRamp:
    """Linear ramp between two tunings.

    Between critically damped tunings, damping is at most 6 % below critical for a stiffness ratio of 4.
    """

    share: Ramp  # share of `after`
    before: Tuning  # until the start
    after: Tuning  # from the end on

    @classmethod
    def at(cls, tuning: Tuning) -> "TuningRamp":
        """Return a constant ramp."""
        return cls(Ramp(0.0, 0.0, 1.0, 1.0), tuning, tuning)

    def sample(self, time: float) -> Tuning:
        """Return the tuning at a time in s; the same object without changes."""
        share = self.share.sample(time)
        return self.after if share >= 1.0 else _between(self.before, self.after, share)

    def towards(self, target: Tuning, time: float, duration: float) -> "TuningRamp":
        """Return a ramp from the present tuning to a target."""
        return TuningRamp(Ramp(time, duration, 0.0, 1.0), self.sample(time), target)


def _between(a: Tuning, b: Tuning, share: float) -> Tuning:
    gains = {
        task: {key: np.asarray(values[key] + share * (b.gains[task][key] - values[key])) for key in values}
        for task, values in a.gains.items()
    }
    return replace(
        b, gains=gains, **{key: getattr(a, key) + share * (getattr(b, key) - getattr(a, key)) for key in _SCALARS}
    )
