"""Motions and targets of the demos."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Move:
    """Motion of the centre of mass through points at rest."""

    name: str
    #: Time since the start of the motion, s, and offset from the standing position, (3,) in m.
    points: tuple[tuple[float, tuple[float, float, float]], ...]
    target_rms: float  # largest RMS tracking error, m

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.points[-1][0]


@dataclass(frozen=True, slots=True)
class Reach:
    """Motion of a frame pose task to a target, enabled and commanded by topics."""

    task: str
    offset: tuple[float, float, float]  # offset from the initial position, world axes, (3,) in m
    duration: float  # s
    target: float  # m


@dataclass(frozen=True, slots=True)
class Shove:
    """Push by a constant force for 0.1 s."""

    name: str
    impulse: tuple[float, float, float]  # world axes, (3,) in N·s
    frame: str = ""  # empty for the base link


@dataclass(frozen=True, slots=True)
class Walk:
    """Walk by `cmd_vel`; the mean velocity counts after the acceleration."""

    name: str
    velocity: tuple[float, float, float]  # forward, to the left and turning, m/s and rad/s
    duration: float = 6.0  # s
    acceleration: float = 3.0  # until the velocity is reached, s
    target: float = 0.05  # largest error of the mean velocity, m/s and rad/s


@dataclass(frozen=True, slots=True)
class Scenario:
    """Demo of a robot."""

    stand: float = 3.0  # s
    moves: tuple[Move, ...] = ()
    reaches: tuple[Reach, ...] = ()
    shoves: tuple[Shove, ...] = ()
    walks: tuple[Walk, ...] = ()  # without a pause; then the robot stops
    stop: float = 4.0  # until the robot has stopped after the walks, s
    recovery: float = 2.0  # until the centre of mass must return after a push, s
    recovery_target: float = 0.02  # largest distance then, m
    force_target: float = 0.01  # of the total vertical force, as a share of the weight
    com: str = "com"  # empty without one


def sway(amplitude: float, target: float) -> Move:
    """Return a motion to the left, to the right and back; m."""
    left, right = (0.0, amplitude, 0.0), (0.0, -amplitude, 0.0)
    return Move("sway", ((1.5, left), (4.0, right), (5.5, (0.0, 0.0, 0.0))), target)


def squat(depth: float, target: float) -> Move:
    """Return a motion down and up; m."""
    down = (0.0, 0.0, -depth)
    return Move("squat", ((1.5, down), (2.5, down), (4.0, (0.0, 0.0, 0.0))), target)


def shoves(sideways: float, along: float, frame: str = "") -> tuple[Shove, ...]:
    """Return pushes from four sides, impulses in N·s, on a frame or the base link."""
    return (
        Shove("shove left", (0.0, sideways, 0.0), frame),
        Shove("shove right", (0.0, -sideways, 0.0), frame),
        Shove("shove forward", (along, 0.0, 0.0), frame),
        Shove("shove backward", (-along, 0.0, 0.0), frame),
    )


SCENARIOS: dict[str, Scenario] = {
    "g1": Scenario(
        moves=(sway(0.04, 0.005), squat(0.10, 0.008)),
        reaches=(Reach("right_hand", (0.15, -0.05, 0.20), 3.0, 0.01),),
        shoves=shoves(11.0, 8.0),
    ),
    "talos": Scenario(
        moves=(sway(0.04, 0.005), squat(0.10, 0.008)),
        reaches=(Reach("right_hand", (0.10, -0.05, 0.10), 3.0, 0.01),),
        shoves=shoves(25.0, 18.0),
    ),
    "go2": Scenario(moves=(sway(0.03, 0.005), squat(0.06, 0.008)), shoves=shoves(8.0, 8.0)),
}
#: Name of the demo of walking, its robot, and its scenario.
WALK, WALK_ROBOT = "walk", "g1"
WALK_SCENARIO = Scenario(
    walks=(
        Walk("walk forward", (0.3, 0.0, 0.0)),
        Walk("turn", (0.0, 0.0, 0.4)),
        Walk("walk to the left", (0.0, 0.15, 0.0)),
        Walk("walk a curve", (0.25, 0.0, -0.3)),
    )
)
