"""The walker of quadrupeds."""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.references.changes import EnableContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Reference
from wbc_controller.walking.feet_kernels import motion_of_points
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import Phase, QuadrupedGait
from wbc_controller.walking.plan import WalkingPlan, margin
from wbc_controller.walking.quadruped_kernels import motion_of_body, next_pair
from wbc_controller.walking.references_kernels import smooth_step
from wbc_controller.walking.swing_kernels import Landing, at_rest, move_axis, moved
from wbc_controller.walking.terrain import Ground
from wbc_controller.walking.touchdown import COUNTS, lands, rebounds
from wbc_controller.walking.walker import STILL, Decision, TaskSets, Walker

_FREEZE = 0.03  # time before touchdown in which the target of the step is constant, s
_LAG = 0.06  # largest distance of the reference of the centre of mass from the measured one, m
#: Largest distance of a foot from its nominal place for a stop, m, and largest commanded speed, m/s and rad/s.
_NOMINAL, _SLOW = 0.06, 0.02


@dataclass(frozen=True, slots=True)
class PointFoot:
    """One foot at the origin of its frame: its contact, and the task on its position."""

    contact: str
    task: str
    frame: int
    row: int  # its index among the feet
    nominal: complex  # place in the nominal posture relative to the middle of all feet, forward + i left in m
    link: int  # index of its link
    offset: tuple[float, ...]  # on the link, (3,) in m


@dataclass(slots=True)  # faster than frozen ones and named tuples
class _Cycle:
    time: float  # s
    dt: float  # time since the last cycle, s
    com: complex  # c, x + i y in m
    dcm: complex  # ξ
    omega: float  # ω, 1/s
    ahead: complex  # unit vector of the heading
    feet: Array  # their positions and velocities, (n, 6)
    touching: Mapping[str, bool]  # states of the contact sensors


class QuadrupedWalker(Walker):
    """Walker of a robot with four point feet; in `Phase.SINGLE` one group of feet swings."""

    gait: QuadrupedGait

    STATE_FIELDS = (
        "phase", "command", "goal", "leaving", "velocity", "steps", "_until", "_since", "_last", "_group",
        "_height", "_heading", "_begun", "_orientations", "_body", "_body_velocity", "_sway", "_start",
        "_swings", "_landings", "_lifted", "_places", "_references",
    )  # fmt: skip

    def __init__(
        self, gait: QuadrupedGait, feet: Sequence[PointFoot], tasks: TaskSets, gravity: float, mass: float
    ) -> None:
        """Make a standing walker; gravity in m/s²."""
        self._feet = {foot.contact: foot for foot in feet}
        self._links, self._offsets = np.array([foot.link for foot in feet]), np.array([foot.offset for foot in feet])
        self._gravity, self._mass = gravity, mass
        super().__init__(gait, tasks)

    def reset(self) -> None:
        """Stand, without a command."""
        super().reset()
        self._group = 0  # group that swings or swings next
        self._body = 0j  # reference of the centre of mass without its sway, x + i y in m
        self._body_velocity = 0j  # its velocity, m/s
        self._sway = 0.0, 0.0, 0.0  # reference of its sway to the left with its rates, m
        self._start = 0j  # `_body` at the start of the phase
        self._swings: dict[str, Array] = {}  # feet in the air, by contact
        self._landings: dict[str, Landing] = {}  # their planned touchdowns
        self._places = np.zeros((len(self._feet), 3))  # last positions of the feet on the ground, m
        self._latest: _Cycle | None = None  # last cycle, for `plan`

    @property
    def contact_sets(self) -> tuple[tuple[str, ...], ...]:
        """Sets of active contacts of the gait: all feet, then without a swinging group, or one foot of it."""
        swinging = {frozenset(group) for group in self.gait.groups} | {frozenset([name]) for name in self._feet}
        sets = [tuple(name for name in self._feet if name not in group) for group in swinging]
        return (tuple(self._feet), *sorted(sets))

    def plan(self) -> WalkingPlan | None:
        """Return the plan of the last cycle, or None while standing; its margin is that of the DCM."""
        if self.phase is Phase.STAND or self._latest is None:
            return None
        cycle, wanted = self._latest, self._body + self._body_velocity / self._latest.omega
        swings = {name: (swing, self._landings[name]) for name, swing in self._swings.items() if name in self._landings}
        edge = margin(cycle.dcm, [self._place(name) for name in self._feet if name not in self._swings])
        elapsed = cycle.time - self._since
        return WalkingPlan.of(self.phase, cycle.dcm, wanted, swings, self.gait.clearance, elapsed, edge)

    def update(
        self, time: float, dynamics: Dynamics, orientations: Mapping[str, Array], touching: Mapping[str, bool]
    ) -> Decision:
        """Decide on contacts and references of one cycle."""
        decision, dt = Decision([], {}), time - self._last
        self._last = time
        if time > self._until:
            self.command = None
        feet = np.empty((len(self._feet), 6))
        motion_of_points(dynamics.joints, dynamics.links, self._links, self._offsets, feet)
        if self.goal is not None:
            standing = self.phase is Phase.STAND
            self._approach(self.goal, *(self._stance(feet) if standing else (self._body, self._heading)))
        if self.phase is Phase.STAND:
            if self.command is None:
                return decision
            dt = 0.0
            self._begin(dynamics, feet, orientations, decision)
        for name, foot in self._feet.items():
            if name not in self._swings:
                self._places[foot.row] = feet[foot.row, :3]
        if self.command is None or self.phase in (Phase.SINGLE, Phase.DOUBLE):
            self.velocity = self.velocity.towards(self.command or Velocity(), self.gait, dt)
        self._heading += self.velocity.turning * dt
        com, dcm, omega = motion_of_body(
            dynamics.com, dynamics.com_velocity, dynamics.centroidal_matrix.T, dynamics.v, self._mass, self._com_height,
            self._gravity,
        )  # fmt: skip
        cycle = _Cycle(time, dt, com, dcm, omega, cmath.rect(1.0, self._heading), feet, touching)
        if self.phase is Phase.STAND:
            self._enter(Phase.SHIFT, cycle)
        ground = Ground.below(self._places)
        if self.phase is Phase.SINGLE:
            self._single(cycle, ground, decision)
        elif self.phase is Phase.DOUBLE:
            self._double(cycle, ground, decision)
        else:
            self._shift(cycle, ground, decision)
        if self.phase is Phase.STAND:
            return decision
        for name, foot in self._feet.items():
            if name not in self._swings:  # the references of stance feet follow their motion: the balls roll
                row = feet[foot.row]
                self._references[foot.task] = Reference(row[:3], row[3:], STILL)
        left, (sway, rate, push) = 1j * cycle.ahead, self._sway
        place, velocity = self._body + sway * left, self._body_velocity + rate * left
        self._command_body(place, velocity, push * left, ground.height_at(cycle.com), self.velocity.turning, dt)
        self._latest = cycle
        decision.references = self._references
        return decision

    def _limited(self, command: Velocity | None) -> Velocity | None:
        """Return a command within the largest speeds; the shares of them have at most the norm 1."""
        command = super()._limited(command)
        if command is None:
            return None
        forward, sideways, turning = self.gait.speed
        share = math.hypot(command.linear.real / forward, command.linear.imag / sideways, command.turning / turning)
        return command.times(1.0 / max(1.0, share))

    def _stance(self, feet: Array) -> tuple[complex, float]:
        """Return the middle of the feet, and the angle from their nominal places to the present ones."""
        places = feet[:, 0] + 1j * feet[:, 1]
        middle = complex(places.mean())
        nominal = np.array([foot.nominal for foot in self._feet.values()])
        return middle, cmath.phase((places - middle) @ nominal.conj())

    def _begin(self, dynamics: Dynamics, feet: Array, orientations: Mapping[str, Array], decision: Decision) -> None:
        self._swings, self._landings, self._references, self._places[:] = {}, {}, {}, feet[:, :3]
        x, y, self._height = dynamics.com.tolist()
        self._body, (_, self._heading) = complex(x, y), self._stance(feet)
        self.steps, self.velocity, self._sway, self._group = 0, Velocity(), (0.0, 0.0, 0.0), 0
        self._begin_tasks(orientations, decision)

    def _place(self, contact: str) -> complex:
        """Return the last place of a foot on the ground, x + i y in m."""
        x, y, _ = self._places[self._feet[contact].row].tolist()
        return complex(x, y)

    def _enter(self, phase: Phase, cycle: _Cycle) -> None:
        self.phase, self._since = phase, cycle.time
        self._start = cycle.com - self._sway[0] * 1j * cycle.ahead

    def _shift(self, cycle: _Cycle, ground: Ground, decision: Decision) -> None:
        elapsed, duration = cycle.time - self._since, self.gait.shift
        share, rate = smooth_step(elapsed / duration)
        way = ground.place - self._start
        self._body = self._start + way * share
        self._body_velocity = way * rate / duration
        goal = self.gait.sway[self._group] if self.phase is Phase.SHIFT else 0.0
        self._sway = move_axis(*self._sway, goal, 0.0, duration - elapsed, cycle.dt)
        if self.phase is Phase.STOP and self.command is not None:
            self._enter(Phase.SHIFT, cycle)
        elif self.phase is Phase.SHIFT and self.command is None and elapsed < 0.5 * duration:
            self._enter(Phase.STOP, cycle)
        elif elapsed >= duration:
            self._lift_off(cycle, decision) if self.phase is Phase.SHIFT else self._stand(decision)

    def _lift_off(self, cycle: _Cycle, decision: Decision) -> None:
        self.phase, self._since, self._landings, self._lifted = Phase.SINGLE, cycle.time, {}, ()
        for name in self.gait.groups[self._group]:
            decision.changes.append(EnableContact(name, False, 0.0))
            self._swings[name] = at_rest(self._place(name), self._places.item(self._feet[name].row, 2), 0.0)

    def _single(self, cycle: _Cycle, ground: Ground, decision: Decision) -> None:
        gait, elapsed = self.gait, cycle.time - self._since
        left = max(gait.swing - elapsed, 0.0)
        self._follow(cycle)
        if left > _FREEZE or not self._landings:
            self._plan_landings(cycle, ground, left)
        for name, swing in list(self._swings.items()):
            foot, landing = self._feet[name], self._landings[name]
            if cycle.dt > 0.0:
                swing = moved(swing, landing, gait.clearance, elapsed - cycle.dt, cycle.dt, descent=0.0)
                self._swings[name] = swing
            self._references[foot.task] = Reference(swing[0, :3], swing[1, :3], swing[2, :3])
            sensor = self._sensor(name, cycle.touching) if cycle.touching else None
            if elapsed >= COUNTS * gait.swing:
                wanted, (vx, vy, vz) = swing.item(1, 2), cycle.feet[foot.row, 3:].tolist()
                speed = math.hypot(vx, vy, vz)
                if rebounds(wanted, vz) or lands(elapsed - gait.swing, wanted, landing.speed, vz, speed, sensor):
                    decision.changes.append(EnableContact(name, True, 0.0))
                    del self._swings[name]
        if not self._swings:
            self.steps += 1
            self._group = (self._group + 1) % len(gait.groups)
            self.phase, self._since = Phase.DOUBLE, cycle.time

    def _plan_landings(self, cycle: _Cycle, ground: Ground, left: float) -> None:
        """Plan the touchdowns after a time in s, at the nominal places about an origin; their height stays."""
        gait, group, walk = self.gait, self.gait.groups[self._group], self.velocity
        trots = len(group) == 2
        stance = gait.swing + gait.pause[(self._group + 1) % len(gait.groups)] if trots else gait.cycle - gait.swing
        turn = cmath.rect(1.0, self._heading + walk.turning * (left + 0.5 * stance))
        velocity, later = walk.linear * cmath.rect(1.0, self._heading + walk.turning * left), walk.linear * turn
        if trots:
            a, b = (self._feet[name] for name in gait.groups[1 - self._group])
            body, middle = next_pair(cycle.dcm, self._places, a.row, b.row, velocity, later, cycle.omega, left, stance)
            origin = -0.5 * (a.nominal + b.nominal)  # of all feet it is 0
        else:
            body = self._body + velocity * left
            middle, origin = body + 0.5 * stance * later, 0j
        away = middle - body
        away *= min(1.0, gait.length / max(abs(away), 1.0e-9))
        for name in self._swings:
            place = body + away + (self._feet[name].nominal - origin) * turn
            known = self._landings.get(name)
            height = ground.height_at(place) if known is None else known.height
            self._landings[name] = Landing(place, height, 0.0, gait.swing)

    def _double(self, cycle: _Cycle, ground: Ground, decision: Decision) -> None:
        elapsed, pause = cycle.time - self._since, self.gait.pause[self._group]
        self._follow(cycle)
        self._sway = move_axis(*self._sway, self.gait.sway[self._group], 0.0, pause - elapsed, cycle.dt)
        still = abs(self.velocity.linear) < _SLOW and abs(self.velocity.turning) < _SLOW
        if self.command is None and still and self._is_nominal(cycle, ground.place):
            self._enter(Phase.STOP, cycle)
        elif elapsed >= pause:
            self._lift_off(cycle, decision)

    def _is_nominal(self, cycle: _Cycle, middle: complex) -> bool:
        feet = self._feet.values()
        return all(abs(self._place(f.contact) - middle - cycle.ahead * f.nominal) < _NOMINAL for f in feet)

    def _follow(self, cycle: _Cycle) -> None:
        self._body_velocity = self.velocity.linear * cycle.ahead
        self._body += self._body_velocity * cycle.dt
        lag = self._body + self._sway[0] * 1j * cycle.ahead - cycle.com
        if abs(lag) > _LAG:
            self._body -= lag * (1.0 - _LAG / abs(lag))
