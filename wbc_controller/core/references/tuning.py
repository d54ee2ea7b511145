"""From one set of gains and limits to another."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wbc_controller.core.references.trajectories import Ramp
from wbc_controller.records import Tuning

_SCALARS = ("position_margin", "position_horizon", "velocity_scale", "acceleration", "torque_rate")


@dataclass(frozen=True, slots=True)
class TuningRamp:
    """A tuning that goes from one to another along straight lines, each number by the same share.

    Between two critically damped laws the damping is a little below critical, as a mean of square roots is below the
    root of the mean: by 6 % at most on the way to a stiffness four times as large.

    Attributes:
        share: of `after`, from 0 to 1.
        before: tuning until the start.
        after: tuning from the end on.
    """

    share: Ramp
    before: Tuning
    after: Tuning

    @classmethod
    def at(cls, tuning: Tuning) -> TuningRamp:
        """One that stays where it is."""
        return cls(Ramp(0.0, 0.0, 1.0, 1.0), tuning, tuning)

    def sample(self, time: float) -> Tuning:
        """Tuning at a time, in s; the same object while nothing changes."""
        share = self.share.sample(time)
        return self.after if share >= 1.0 else _between(self.before, self.after, share)

    def towards(self, target: Tuning, time: float, duration: float) -> TuningRamp:
        """A ramp from where this one is to a new target."""
        return TuningRamp(Ramp(time, duration, 0.0, 1.0), self.sample(time), target)


def _between(a: Tuning, b: Tuning, share: float) -> Tuning:
    gains = {
        task: {key: values[key] + share * (b.gains[task][key] - values[key]) for key in values}
        for task, values in a.gains.items()
    }
    return replace(
        b, gains=gains, **{key: getattr(a, key) + share * (getattr(b, key) - getattr(a, key)) for key in _SCALARS}
    )
