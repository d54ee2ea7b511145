"""The walker of bipeds."""

import cmath
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from wbc_controller.inverse_dynamics.references.changes import EnableContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array
from wbc_controller.walking.adaptation_kernels import SHORTEST, SHORTEST_ROUGH, adapt, dcm_towards, steps_again
from wbc_controller.walking.fall_kernels import STANDING, missed, nearest_support
from wbc_controller.walking.feet import Foot, Sole, mean_angle
from wbc_controller.walking.footsteps import (
    Footstep,
    NominalStep,
    Stance,
    Velocity,
    nominal_step,
    planned,
    step_towards,
)
from wbc_controller.walking.footsteps_kernels import swing_push
from wbc_controller.walking.gait import Gait, Phase
from wbc_controller.walking.pendulum_kernels import before, natural_frequency
from wbc_controller.walking.plan import WalkingPlan, margin
from wbc_controller.walking.references_kernels import nearest_in_support, smooth_step
from wbc_controller.walking.swing_kernels import Landing, at_rest
from wbc_controller.walking.terrain import FOOTHOLDS, Ground, Roughness, aim_below, plane_through
from wbc_controller.walking.touchdown import SoleTouchdown
from wbc_controller.walking.walker import Decision, TaskSets, Walker
from wbc_controller.walking.weight_transfer import WeightTransfer

_GAIN = 5.0  # feedback gain on the DCM, 1/s
_BLEND = 0.2  # blending time of the DCM reference between phases, s
_FREEZE = 0.05  # time before touchdown in which the target of the step is constant, s
#: Least share of the nominal duration of a step that measures the roughness: faster feet land tilted.
_MEASURES = 0.75
#: Distance beyond the side of the stance foot to which the demanded centre of pressure may move, m per m of height:
#: the angular momentum of trunk and arms replaces the missing moment. None on ground of this unevenness, m, where an
#: edge may support the sole.
_BEYOND, _EDGES = 0.18, 0.01
#: Largest change of a flat stance sole's slope since lift-off, and displacement of the centre of pressure per further
#: change, m.
_FLAT, _FLATTENING = 0.03, 0.6
_HEADING_RATE = 6.0  # rate of the heading towards its goal, 1/s
#: Largest distance between the feet along the heading for a stop, m: first, and after a number of steps.
_BESIDE, _NEAR, _AT_LAST = 0.04, 0.1, 3
_SLOW = 0.02  # largest commanded speed for a stop, m/s


@dataclass(frozen=True, slots=True)
class LiftOff:
    """Constants of a single support."""

    stance: Stance
    ground: Ground  # plane through the last footholds
    clearance: float  # of the swing foot, m
    shortest: float  # duration of the fastest step, s
    planned: bool  # True for a planned footstep


@dataclass(slots=True)  # not frozen: faster construction
class Step:
    """A single support after one cycle."""

    begun: LiftOff
    nominal: NominalStep
    landing: Landing
    swing: Array  # motion of the swing foot, (3, 4) (`swing_kernels`)
    acceleration: complex  # of the swing foot at the time at which the torques act, ẍ + i ÿ in m/s²
    slope: complex  # of the swing foot, dz/dx + i dz/dy


@dataclass(slots=True)  # faster than frozen ones and named tuples
class _Cycle:
    time: float  # s
    dt: float  # time since the last cycle, s
    dcm: complex  # ξ, x + i y in m
    soles: Mapping[int, Sole]  # by side: 1 left, -1 right
    touching: Mapping[str, bool]  # states of the contact sensors
    dynamics: Dynamics


class BipedWalker(Walker):
    """Walker of a robot with two flat feet.

    Attributes:
        footsteps: planned footsteps that have not begun; meanwhile the command is to step in place.
    """

    gait: Gait

    STATE_FIELDS = (
        "phase", "command", "goal", "footsteps", "leaving", "velocity", "steps", "_until", "_since", "_last", "_stance",
        "_height", "_heading", "_begun", "_orientations", "_step", "_lifted", "_blend", "_dcm_wanted",
        "_transfer", "_touchdown_detection", "_stopping", "_references", "_footholds", "_roughness", "fall_prediction",
    )  # fmt: skip

    def __init__(self, gait: Gait, left: Foot, right: Foot, tasks: TaskSets, gravity: float, lag: float = 0.0) -> None:
        """Make a standing walker; gravity in m/s², and the delay of the torques in s."""
        self._feet, self._gravity, self._lag = {1: left, -1: right}, gravity, lag
        super().__init__(gait, tasks)
        self._omega = natural_frequency(self._com_height, gravity)  # ω, 1/s
        self._feedback = 1.0 + _GAIN / self._omega  # of the centre of pressure on the DCM

    def reset(self) -> None:
        """Stand, without a command."""
        super().reset()
        self.footsteps: tuple[Footstep, ...] = ()
        self._stance = -1  # side of the stance foot
        self._stopping = 0  # touchdowns since the command to stand
        self._step: Step | None = None
        self._dcm_wanted = 0j
        self._blend = 0j  # reference of the DCM at the start of the phase; in a step, minus the step's reference
        self._transfer: WeightTransfer | None = None  # of the last double support
        self._touchdown_detection = SoleTouchdown()
        self._footholds: tuple[Ground, ...] = ()  # newest first
        self._roughness = Roughness()
        self._latest: tuple[_Cycle, complex] | None = None  # last cycle and its centre of pressure, for `plan`

    def ask(self, command: Velocity | None, until: float = math.inf) -> None:
        """Walk at a velocity until a time, s; None to stand; errors as in `Walker`."""
        super().ask(command, until)
        self.footsteps = ()
        if self._step is not None:
            self._step = replace(self._step, begun=replace(self._step.begun, planned=False))

    def follow(self, poses: Array, dynamics: Dynamics) -> None:
        """Step on poses of the soles (x, y in m, heading in rad, (n, 3)), bring the feet side by side, and stop.

        The feet alternate. A standing robot begins with the foot nearer to its pose. Errors as in `Walker`.
        """
        soles = {side: foot.sole(dynamics) for side, foot in self._feet.items()}
        first, feet = None, {side: (sole.place, sole.heading) for side, sole in soles.items()}
        if self.phase is Phase.SINGLE and self._step is not None:  # the foot in the air lands as planned before
            landing, first = self._step.landing, self._stance
            feet[-first] = landing.place, landing.heading
        elif self.phase is not Phase.STAND:
            first = -self._stance
        steps = planned(poses, feet, first, self.gait)
        self.ask(Velocity())
        self.footsteps = steps

    @property
    def footsteps_left(self) -> int:  # type: ignore[override]
        """Number of planned footsteps without a touchdown."""
        begun = self.phase is Phase.SINGLE and self._step is not None and self._step.begun.planned
        return len(self.footsteps) + begun

    @property
    def contact_sets(self) -> tuple[tuple[str, ...], ...]:
        """Sets of active contacts of the gait: both feet, then each of them."""
        left, right = self._feet[1].contact, self._feet[-1].contact
        return (left, right), (left,), (right,)

    def plan(self) -> WalkingPlan | None:
        """Return the plan of the last cycle, or None while standing."""
        if self.phase is Phase.STAND or self._latest is None:
            return None
        (cycle, pressure), feet, swings = self._latest, list(self._feet.values()), {}
        clearance, elapsed = self.gait.clearance, self._latest[0].time - self._since
        if self.phase is Phase.SINGLE and self._step is not None:
            feet, clearance = [self._feet[self._stance]], self._step.begun.clearance
            swings = {self._feet[-self._stance].contact: (self._step.swing, self._step.landing)}
        edge = margin(pressure, [point for foot in feet for point in foot.corners(cycle.dynamics)])
        return WalkingPlan.of(self.phase, cycle.dcm, self._dcm_wanted, swings, clearance, elapsed, edge)

    def update(
        self, time: float, dynamics: Dynamics, orientations: Mapping[str, Array], touching: Mapping[str, bool]
    ) -> Decision:
        """Decide on contacts and references of one cycle."""
        decision, dt = Decision([], {}), time - self._last
        self._last = time
        if time > self._until:
            self.command = None
        left, right = self._feet.values()
        soles = {1: left.sole(dynamics), -1: right.sole(dynamics)}
        if self.goal is not None:
            self._approach(self.goal, *self._pose(soles))
        if self.phase is Phase.STAND:
            if self.command is None:
                return decision
            dt = 0.0
            self._begin(dynamics, soles, orientations, decision)
        (x, y, _), (vx, vy, _) = dynamics.com.tolist(), dynamics.com_velocity.tolist()
        com, velocity = complex(x, y), complex(vx, vy)
        cycle = _Cycle(time, dt, com + velocity / self._omega, soles, touching, dynamics)
        self.velocity = self.velocity.towards(self.command or Velocity(), self.gait, dt)
        if self.phase is Phase.STAND:
            self._enter(Phase.SHIFT, cycle)
        if self.phase is Phase.SINGLE and self._step is not None:
            pressure = self._single(self._step, cycle, decision)
        elif self.phase is Phase.DOUBLE and self._transfer is not None:
            pressure = self._double(self._transfer, cycle, decision)
        else:
            pressure = self._shift(cycle, decision)
        if self.phase is Phase.STAND:
            return decision
        self._latest = cycle, pressure
        if self.fall_prediction.is_due(time):
            self._predict_fall(cycle)
        acceleration = self._omega**2 * (com - pressure)
        if self.phase is Phase.SINGLE and self._step is not None:
            acceleration += self.gait.reaction * self._step.acceleration
        height, turning = soles[self._stance].height, self._turn(soles, dt)
        self._command_body(com, velocity, acceleration, height, turning, dt)
        decision.references = self._references
        return decision

    def _predict_fall(self, cycle: _Cycle) -> None:
        gait, one, elapsed = self.gait, self.phase is Phase.SINGLE, cycle.time - self._since
        remaining = SHORTEST * gait.single
        if one:
            remaining = max(remaining - elapsed, 0.0)
        elif self.phase is Phase.DOUBLE:
            remaining += max(gait.double - elapsed, 0.0)
        first = cycle.soles[self._stance]
        second = first if one else cycle.soles[-self._stance]
        distance, most = missed(
            cycle.dcm, first.place, first.heading, second.place, second.heading, *self._feet[1].half,
            gait.sizes, self._omega, remaining,
        )  # fmt: skip
        self.fall_prediction.compare(cycle.time, distance, most, "all footholds that can be reached")

    def watch_standing(self, time: float, dynamics: Dynamics, active: Collection[str]) -> None:
        """Predict a fall of a robot that is supported by its feet alone, at the time of a state, s."""
        soles = [foot.sole(dynamics) for foot in self._feet.values() if foot.contact in active]
        if not soles or len(soles) < len(active):
            self.fall_prediction.clear(time)
            return
        (x, y, z), (vx, vy, _) = dynamics.com.tolist(), dynamics.com_velocity.tolist()
        height = z - min(sole.height for sole in soles)
        if height <= 0.0:
            return
        omega = natural_frequency(height, self._gravity)
        dcm, first, second = complex(x + vx / omega, y + vy / omega), soles[0], soles[-1]
        support = nearest_support(dcm, first.place, second.place, first.heading, *self._feet[1].half)
        self.fall_prediction.compare(time, abs(dcm - support), STANDING * height, "the feet")

    def _begin(
        self, dynamics: Dynamics, soles: Mapping[int, Sole], orientations: Mapping[str, Array], decision: Decision
    ) -> None:
        self._height = float(dynamics.com[2])
        self._heading = mean_angle(soles[1].heading, soles[-1].heading)
        self._references = {foot.task: foot.at_rest(dynamics) for foot in self._feet.values()}
        self.steps, self.velocity, self._step = 0, Velocity(), None
        self._stance = 1 if self.command is not None and self.command.linear.imag < 0.0 else -1
        if self.footsteps:
            self._stance = -self.footsteps[0].side
        self._footholds = (soles[-self._stance].ground, soles[self._stance].ground)
        self._begin_tasks(orientations, decision)

    def _pose(self, soles: Mapping[int, Sole]) -> tuple[complex, float]:
        """Return place and heading of the middle between the feet.

        While the robot walks, the middle is beside the stance foot, half of the nominal width away.
        """
        stance = soles[self._stance]
        if self.phase is Phase.STAND:
            return 0.5 * (soles[1].place + soles[-1].place), stance.heading
        beside = 0.5j * self._stance * self.gait.width * cmath.rect(1.0, stance.heading)
        return stance.place - beside, stance.heading

    def _next_step(self, velocity: Velocity, cycle: _Cycle) -> tuple[Stance, NominalStep, complex]:
        """Return the single support to the next planned footstep, or at a velocity, and the DCM at its start."""
        foot, sole, gait = cycle.soles[-self._stance], cycle.soles[self._stance], self.gait
        stance = Stance(sole.place, sole.heading, -self._stance, self._omega)
        if self.footsteps:
            step = step_towards(self.footsteps, stance, gait)
        else:
            step = nominal_step(velocity, stance, gait, gait.single)
        push = swing_push(gait.reaction, gait.single, self._omega) * (step.place - foot.place)
        return stance, step, before(step.place + step.offset, sole.place, self._omega, gait.single, push)

    def _enter(self, phase: Phase, cycle: _Cycle) -> None:
        self.phase, self._since, self._blend = phase, cycle.time, cycle.dcm

    def _shift(self, cycle: _Cycle, decision: Decision) -> complex:
        """Move the DCM to the start of the first step, or for a stop to the middle; return the centre of pressure."""
        soles, elapsed, duration = cycle.soles, cycle.time - self._since, self.gait.shift
        goal = 0.5 * (soles[1].place + soles[-1].place)
        if self.phase is Phase.SHIFT:
            _, _, goal = self._next_step(Velocity(), cycle)
        share, rate = smooth_step(elapsed / duration)
        self._dcm_wanted = self._blend + (goal - self._blend) * share
        pressure = self._dcm_wanted - (goal - self._blend) * rate / (duration * self._omega)
        if self.phase is Phase.STOP and self.command is not None:
            self._enter(Phase.SHIFT, cycle)
        elif self.phase is Phase.SHIFT and self.command is None and elapsed < 0.5 * duration:
            self._enter(Phase.STOP, cycle)
        elif elapsed >= duration:
            self._lift_off(cycle, decision) if self.phase is Phase.SHIFT else self._stand(decision)
        return self._corrected(pressure, cycle, soles[1].place, soles[-1].place)

    def _lift_off(self, cycle: _Cycle, decision: Decision) -> None:
        foot, sole = cycle.soles[-self._stance], cycle.soles[self._stance]
        decision.changes.append(EnableContact(self._feet[-self._stance].contact, False, 0.0))
        # The estimated height has drifted since the swing foot became the stance foot.
        drift = foot.height - self._footholds[0].height
        earlier = [replace(each, height=each.height + drift) for each in self._footholds[: FOOTHOLDS - 1]]
        self._footholds = (sole.ground, *earlier)
        self._swing(cycle, plane_through(self._footholds))

    def _swing(self, cycle: _Cycle, ground: Ground) -> None:
        """Begin a single support on a plane through the footholds."""
        foot, gait, rough = cycle.soles[-self._stance], self.gait, self._roughness
        self.phase, self._since, self._lifted = Phase.SINGLE, cycle.time, ()
        stance, nominal, start = self._next_step(self.velocity, cycle)
        planned, self.footsteps = bool(self.footsteps), self.footsteps[1:]
        shortest = gait.single * (SHORTEST + (SHORTEST_ROUGH - SHORTEST) * rough.share)
        height = ground.height_at(nominal.place) - aim_below(rough.share)
        self._step = Step(
            begun=LiftOff(stance, ground, gait.clearance_on(rough.share), shortest, planned),
            nominal=nominal,
            landing=Landing(nominal.place, height, nominal.heading, gait.single, rough.touchdown_speed, rough.share),
            swing=at_rest(foot.place, foot.height, foot.heading),
            acceleration=0j,
            slope=foot.slope,
        )
        self._blend = self._dcm_wanted - start

    def _single(self, step: Step, cycle: _Cycle, decision: Decision) -> complex:
        """Adapt the step, and move the swing foot; return the centre of pressure."""
        gait, elapsed, dt = self.gait, cycle.time - self._since, cycle.dt
        foot, begun, nominal = self._feet[-self._stance], step.begun, step.nominal
        stance, ground, landing, swing = begun.stance, begun.ground, step.landing, step.swing
        if landing.time - elapsed > _FREEZE:
            # The ground has sunk since lift-off, also by drift of the estimate.
            sunk = cycle.soles[self._stance].height - self._footholds[0].height
            level = ground.height + sunk - aim_below(landing.roughness)
            to, facing, offset, place, height, heading, duration, wanted = adapt(
                begun.planned, nominal.place, nominal.heading, nominal.offset, self.velocity.linear,
                self.velocity.turning, landing.place, landing.time, stance.place, stance.heading, stance.side,
                stance.omega, gait.sizes, cycle.dcm, swing, ground.place, level, ground.slope, elapsed, dt,
                begun.shortest,
            )  # fmt: skip
            nominal = NominalStep(to, facing, offset)
            landing = Landing(place, height, heading, duration, landing.speed, landing.roughness)
        else:
            left = max(landing.time - elapsed, 0.0)
            wanted = dcm_towards(nominal.place, nominal.offset, stance.place, stance.omega, gait.reaction, swing, left)
        if elapsed < _BLEND:
            share, _ = smooth_step(elapsed / _BLEND)
            wanted += self._blend * (1.0 - share)
        self._dcm_wanted = wanted
        swing, acceleration, slope, self._references[foot.task] = foot.swung(
            swing, landing, step.slope, ground.slope, begun.clearance, elapsed - dt, dt, self._lag
        )
        self._step = step = Step(begun, nominal, landing, swing, acceleration, slope)
        sole, sensor = cycle.soles[-self._stance], self._sensor(foot.contact, cycle.touching)
        if self._touchdown_detection.update(cycle.time, elapsed, swing, landing, begun.clearance, sole, sensor):
            if not (begun.planned or self.footsteps) and steps_again(
                cycle.dcm, stance.place, stance.heading, sole.place, sole.heading, stance.side, self._omega, gait.sizes,
                begun.shortest,
            ):  # fmt: skip
                self._swing(cycle, ground)
            else:
                self._land(step, cycle, elapsed - landing.time, decision)
        beyond = _BEYOND * self._com_height * max(0.0, 1.0 - self._roughness.unevenness / _EDGES)
        pressure = self._corrected(stance.place, cycle, stance.place, stance.place, beyond)
        rolled = cycle.soles[self._stance].slope - self._footholds[0].slope
        if abs(rolled) > _FLAT and self.phase is Phase.SINGLE:
            # The sole rolls over its edge: the centre of pressure moves to the raised side. The error of the estimated
            # slope is larger than the distance to the edge: the slope counts from that at lift-off.
            held, usable = cycle.soles[self._stance], self._feet[self._stance].usable
            pressure += _FLATTENING * (abs(rolled) - _FLAT) * rolled / abs(rolled)
            pressure = nearest_in_support(pressure, held.place, held.place, held.heading, *usable)
        return pressure

    def _land(self, step: Step, cycle: _Cycle, late: float, decision: Decision) -> None:
        """Begin a double support, `late` after the planned touchdown, s."""
        foot, sole = self._feet[-self._stance], cycle.soles[-self._stance]
        unexpected = abs(sole.height - step.landing.height - aim_below(step.landing.roughness))
        self._roughness.add(unexpected, step.landing.time > _MEASURES * self.gait.single)
        decision.changes.append(EnableContact(foot.contact, True, 0.0))
        self._references[foot.task] = foot.at_rest(cycle.dynamics)
        self.phase, self._since, self.steps = Phase.DOUBLE, cycle.time, self.steps + 1
        self._stance = -self._stance
        _, _, start = self._next_step(self.velocity, cycle)
        self._transfer = WeightTransfer.after_touchdown(
            late, cycle.dcm, start, step.begun.stance.place, sole.place, sole.heading, self._omega, self.gait,
            step.landing.roughness,
        )  # fmt: skip
        self._stopping = self._stopping + 1 if self.command is None else 0
        if step.begun.planned and not self.footsteps:
            self.command = None

    def _double(self, transfer: WeightTransfer, cycle: _Cycle, decision: Decision) -> complex:
        """Transfer the weight; return the centre of pressure."""
        self._dcm_wanted, pressure, ended = transfer.at(cycle.time - self._since, self._omega)
        heading = cycle.soles[self._stance].heading
        beside = abs(((transfer.new - transfer.old) * cmath.rect(1.0, -heading)).real)
        enough = _BESIDE if self._stopping < _AT_LAST else _NEAR
        if self.command is None and beside < enough and abs(self.velocity.linear) < _SLOW:
            self._enter(Phase.STOP, cycle)
        elif ended:
            self._lift_off(cycle, decision)
        return self._corrected(pressure, cycle, transfer.old, transfer.new)

    def _corrected(
        self, pressure: complex, cycle: _Cycle, first: complex, second: complex, beyond: float = 0.0
    ) -> complex:
        """Return the centre of pressure that moves the DCM to its reference, in the support or `beyond` its sides, m.

        ξ̇ = ω (ξ - p) = ξ̇* - k (ξ - ξ*) needs p = p* + (1 + k / ω) (ξ - ξ*).
        """
        foot, heading = self._feet[self._stance], cycle.soles[self._stance].heading
        pressure += self._feedback * (cycle.dcm - self._dcm_wanted)
        length, width = foot.usable
        return nearest_in_support(pressure, first, second, heading, length, width + beyond)

    def _turn(self, soles: Mapping[int, Sole], dt: float) -> float:
        """Turn the heading to that of the feet; return its rate, rad/s."""
        if self._step is None:
            goal = mean_angle(soles[1].heading, soles[-1].heading)
        else:
            goal = mean_angle(self._step.begun.stance.heading, self._step.nominal.heading)
        rate = _HEADING_RATE * math.remainder(goal - self._heading, math.tau)
        self._heading += rate * dt
        return rate
