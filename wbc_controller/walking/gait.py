"""Phases and parameters of gaits."""

from dataclasses import dataclass, field
from enum import Enum

from wbc_controller.walking.footsteps_kernels import StepSizes


class Phase(Enum):
    """A phase of walking."""

    STAND = "stand"  # both feet, no step is planned
    SHIFT = "shift"  # both feet, the weight moves over the first stance foot
    SINGLE = "single support"
    DOUBLE = "double support"
    STOP = "stop"  # both feet, the weight moves to the middle


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLimits:
    """Limits of the velocity command."""

    #: Largest speeds forward (backward: half of it), sideways and turning, m/s and rad/s.
    speed: tuple[float, float, float]
    acceleration: tuple[float, float, float] = (0.3, 0.3, 0.6)  # largest rates of these speeds, m/s² and rad/s²
    braking: float = 2.0  # ratio of the largest deceleration to a stop to the largest acceleration


@dataclass(frozen=True, slots=True)
class Gait(SpeedLimits):
    """Parameters of a biped's gait."""

    single: float  # nominal duration of the single support, s
    double: float  # duration of the double support, s
    shift: float  # duration of the first and the last shift of the weight, s
    height: float  # of the centre of mass above the ground in the nominal posture, m
    lowering: float  # of the centre of mass from this height while walking, m: long steps need bent knees
    clearance: float  # height of the swing foot above the ground, m
    rough_clearance: float  # its height above rough ground, m
    width: float  # nominal distance between the feet, m
    least_width: float  # smallest distance between the feet, m
    length: float  # longest step forward or backward, m
    greatest_width: float  # largest distance between the feet, m
    sole_length: float  # length of the longer sole, m
    sole_width: float  # width of the wider sole, m
    reaction: float  # μ of the swing foot's acceleration ẍ, c̈ = ω² (c - p) + μ ẍ
    sizes: StepSizes = field(init=False, repr=False, compare=False)  # the fields of the same names, for kernels

    def __post_init__(self) -> None:
        sizes = StepSizes(**{name: getattr(self, name) for name in StepSizes.__annotations__})
        object.__setattr__(self, "sizes", sizes)

    def clearance_on(self, roughness: float) -> float:
        """Return the height of the swing foot above ground of a roughness from 0 (even) to 1, m."""
        return self.clearance + roughness * (self.rough_clearance - self.clearance)

    @property
    def step_time(self) -> float:
        """Nominal duration of one step, s."""
        return self.single + self.double


@dataclass(frozen=True, slots=True)
class QuadrupedGait(SpeedLimits):
    """Parameters of a quadruped's gait."""

    groups: tuple[tuple[str, ...], ...]  # contacts of the feet that swing together, in the order of their swings
    #: Leftward offset of the centre of mass from the middle of the feet during the swing of each group, m.
    sway: tuple[float, ...]
    swing: float  # duration of a swing, s
    pause: tuple[float, ...]  # duration of the support by all feet before each swing, s
    shift: float  # the same before the first swing, and after the last, s
    height: float  # of the centre of mass above the ground in the nominal posture, m
    lowering: float  # of the centre of mass from this height while walking, m
    clearance: float  # height of a swing foot above the ground, m
    length: float  # largest distance of a foot from its nominal place below the body, m

    @property
    def cycle(self) -> float:
        """Duration of the swings of all groups and the pauses between, s."""
        return len(self.groups) * self.swing + sum(self.pause)

    @property
    def step_time(self) -> float:
        """Mean duration of a swing and the pause before it, s."""
        return self.cycle / len(self.groups)
