"""Ramps from one set of gains and limits to another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.inverse_dynamics.references.trajectories import Ramp
from wbc_controller.records import Tuning

_SCALARS = ("position_margin", "position_horizon", "velocity_scale", "acceleration", "torque_rate")


@dataclass(frozen=True, slots=True)
class TuningRamp:
    """A linear ramp from one tuning to another, with the same share for every number.

    Between two critically damped tunings the damping is a little below critical, as the mean of square roots is below
    the root of the mean: by at most 6 % on the way to a stiffness four times as large.

    Attributes:
        share: ramp of the share of `after`, from 0 to 1.
        before: tuning until the start.
        after: tuning from the end on.
    """

    share: Ramp
    before: Tuning
    after: Tuning

    @classmethod
    def at(cls, tuning: Tuning) -> TuningRamp:
        """A ramp that stays at one tuning."""
        return cls(Ramp(0.0, 0.0, 1.0, 1.0), tuning, tuning)

    def sample(self, time: float) -> Tuning:
        """Tuning at a time, in s; the same object while nothing changes."""
        share = self.share.sample(time)
        return self.after if share >= 1.0 else _between(self.before, self.after, share)

    def towards(self, target: Tuning, time: float, duration: float) -> TuningRamp:
        """A ramp from the present tuning of this one to a new target."""
        return TuningRamp(Ramp(time, duration, 0.0, 1.0), self.sample(time), target)


def _between(a: Tuning, b: Tuning, share: float) -> Tuning:
    gains = {
        task: {key: np.asarray(values[key] + share * (b.gains[task][key] - values[key])) for key in values}
        for task, values in a.gains.items()
    }
    return replace(
        b, gains=gains, **{key: getattr(a, key) + share * (getattr(b, key) - getattr(a, key)) for key in _SCALARS}
    )
