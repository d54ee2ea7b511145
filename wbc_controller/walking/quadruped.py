"""The walker of quadrupeds."""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.references.changes import EnableContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Reference
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import Phase, QuadrupedGait
from wbc_controller.walking.pendulum import natural_frequency
from wbc_controller.walking.plan import WalkingPlan, margin, swing_path
from wbc_controller.walking.references import smooth_step
from wbc_controller.walking.swing import Landing, at_rest, moved
from wbc_controller.walking.swing_kernels import move_axis
from wbc_controller.walking.terrain import Ground
from wbc_controller.walking.touchdown import COUNTS, lands, rebounds
from wbc_controller.walking.trot_placement import SupportLine, middle_of_pair
from wbc_controller.walking.walker import Decision, TaskSets, Walker

#: Time before touchdown in which the target of the step is constant, s.
_FREEZE = 0.03
#: Largest distance of the reference of the centre of mass from the measured one, m.
_LAG = 0.06
#: Largest distance of a foot from its nominal place for a stop, m, and largest commanded speed, m/s and rad/s.
_NOMINAL, _SLOW = 0.06, 0.02


@dataclass(frozen=True, slots=True)
class PointFoot:
    """One foot at the origin of its frame: its contact, and the task on its position.

    Attributes:
        nominal: place in the nominal posture relative to the middle of all feet, forward + i left in m.
    """

    contact: str
    task: str
    frame: int
    nominal: complex

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return the velocity in world axes, (3,) in m/s."""
        return dynamics.velocity(self.frame, pin.LOCAL_WORLD_ALIGNED)[:3]


class _Cycle(NamedTuple):
    time: float  # s
    dt: float  # time since the last cycle, s
    dynamics: Dynamics
    com: complex  # c, x + i y in m
    dcm: complex  # ξ
    omega: float  # ω, 1/s
    points: Mapping[str, Array]  # positions of the feet, by contact, (3,) in m
    touching: Mapping[str, bool]  # states of the contact sensors


class QuadrupedWalker(Walker):
    """Walker of a robot with four point feet; in `Phase.SINGLE` one group of feet swings."""

    gait: QuadrupedGait

    STATE_FIELDS = (
        "phase", "command", "goal", "leaving", "velocity", "steps", "_until", "_since", "_last", "_group", "_clearance",
        "_height", "_heading", "_orientations", "_body", "_body_velocity", "_sway", "_start",
        "_swings", "_landings", "_lifted", "_places", "_references",
    )  # fmt: skip

    def __init__(
        self,
        gait: QuadrupedGait,
        feet: Sequence[PointFoot],
        tasks: TaskSets,
        gravity: float,
        mass: float,
    ) -> None:
        """Make a standing walker; gravity in m/s²."""
        self.gait = gait
        self._feet = {foot.contact: foot for foot in feet}
        self._gravity, self._mass = gravity, mass
        super().__init__(tasks)

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
        self._places: dict[str, Array] = {}  # last positions of the feet on the ground, by contact, (3,) in m
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
        cycle, gait = self._latest, self.gait
        elapsed = cycle.time - self._since
        return WalkingPlan(
            phase=self.phase.value,
            dcm=cycle.dcm,
            wanted_dcm=self._body + self._body_velocity / cycle.omega,
            swings={
                name: swing_path(swing, self._landings[name], gait.clearance, elapsed)
                for name, swing in self._swings.items()
                if name in self._landings
            },
            landings={
                name: np.array([each.place.real, each.place.imag, each.height])
                for name, each in self._landings.items()
                if name in self._swings
            },
            remaining=max(0.0, gait.swing - elapsed) if self._swings else math.inf,
            margin=margin(cycle.dcm, [self._place(name) for name in self._feet if name not in self._swings]),
        )

    def update(
        self, time: float, dynamics: Dynamics, orientations: Mapping[str, Array], touching: Mapping[str, bool]
    ) -> Decision:
        """Decide on contacts and references of one cycle."""
        decision, dt = Decision(), time - self._last
        self._last = time
        if time > self._until:
            self.command = None
        points = {name: np.array(dynamics.placement(foot.frame).translation) for name, foot in self._feet.items()}
        if self.goal is not None:
            standing = self.phase is Phase.STAND
            self._approach(self.goal, *(self._stance(points) if standing else (self._body, self._heading)))
        if self.phase is Phase.STAND:
            if self.command is None:
                return decision
            dt = 0.0
            self._begin(dynamics, points, orientations, decision)
        self._places |= {name: point for name, point in points.items() if name not in self._swings}
        omega = natural_frequency(self._clearance, self._gravity)
        (x, y, _), (vx, vy, _) = dynamics.com.tolist(), dynamics.com_velocity.tolist()
        # Without the angular momentum of the swinging legs, the velocity is ċ + (L_y, -L_x) / (m z).
        spin = (dynamics.centroidal_matrix[3:5] @ dynamics.v).tolist()
        place, speed = complex(x, y), complex(vx, vy) - 1j * complex(*spin) / (self._mass * self._clearance)
        cycle = _Cycle(
            time=time,
            dt=dt,
            dynamics=dynamics,
            com=place,
            dcm=place + speed / omega,
            omega=omega,
            points=points,
            touching=touching,
        )
        if self.command is None or self.phase in (Phase.SINGLE, Phase.DOUBLE):
            self.velocity = self.velocity.towards(self.command or Velocity(), self.gait, dt)
        if self.phase is Phase.STAND:
            self._enter(Phase.SHIFT, cycle)
        ground = Ground.below(self._places.values())
        self._heading += self.velocity.turning * dt
        if self.phase is Phase.SINGLE:
            self._single(cycle, ground, decision)
        elif self.phase is Phase.DOUBLE:
            self._double(cycle, decision)
        else:
            self._shift(cycle, decision)
        if self.phase is Phase.STAND:
            return decision
        for name in [each for each in self._feet if each not in self._swings]:
            # The references of stance feet follow their motion, because the balls roll.
            foot = self._feet[name]
            self._references[foot.task] = Reference(points[name], foot.velocity(dynamics), np.zeros(3))
        self._move_body()
        self._hold_height(ground.height_at(cycle.com), dt)
        self._turn_tasks(self.velocity.turning)
        self._latest = cycle
        decision.references = dict(self._references)
        return decision

    def _limited(self, command: Velocity | None) -> Velocity | None:
        """Return a command within the largest speeds; the shares of them have at most the norm 1."""
        command = super()._limited(command)
        if command is None:
            return None
        forward, sideways, turning = self.gait.speed
        share = math.hypot(command.linear.real / forward, command.linear.imag / sideways, command.turning / turning)
        return command.times(1.0 / max(1.0, share))

    def _stance(self, points: Mapping[str, Array]) -> tuple[complex, float]:
        """Return the middle of the feet, and the angle from their nominal places to the present ones."""
        places = {name: complex(point[0], point[1]) for name, point in points.items()}
        middle = sum(places.values()) / len(places)
        return middle, cmath.phase(
            sum((places[name] - middle) * f.nominal.conjugate() for name, f in self._feet.items())
        )

    def _begin(
        self,
        dynamics: Dynamics,
        points: Mapping[str, Array],
        orientations: Mapping[str, Array],
        decision: Decision,
    ) -> None:
        self._swings, self._landings, self._places = {}, {}, dict(points)
        com = dynamics.com
        self._body = complex(com[0], com[1])
        self._height = float(com[2])
        self._clearance = self._height - Ground.below(points.values()).height_at(self._body) - self.gait.lowering
        _, self._heading = self._stance(points)
        self._references = {}
        self.steps, self.velocity, self._sway, self._group = 0, Velocity(), (0.0, 0.0, 0.0), 0
        self._begin_tasks(orientations, decision)

    def _place(self, contact: str) -> complex:
        """Return the last place of a foot on the ground, x + i y in m."""
        return complex(self._places[contact][0], self._places[contact][1])

    def _middle(self) -> complex:
        """Return the mean of the last places of the feet, x + i y in m."""
        return sum(self._place(name) for name in self._feet) / len(self._feet)

    def _enter(self, phase: Phase, cycle: _Cycle) -> None:
        """Enter a phase; the reference of the centre of mass begins at the measured one."""
        self.phase, self._since = phase, cycle.time
        self._start = cycle.com - self._sway_in_world(self._sway[0])

    def _shift(self, cycle: _Cycle, decision: Decision) -> None:
        """Move the body over the middle of the feet."""
        elapsed, duration = cycle.time - self._since, self.gait.shift
        share, rate = smooth_step(elapsed / duration)
        way = self._middle() - self._start
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
        """Begin the swing of the next group."""
        self.phase, self._since, self._landings, self._lifted = Phase.SINGLE, cycle.time, {}, ()
        for name in self.gait.groups[self._group]:
            decision.changes.append(EnableContact(name, False, 0.0))
            self._swings[name] = at_rest(cycle.points[name], 0.0)

    def _single(self, cycle: _Cycle, ground: Ground, decision: Decision) -> None:
        """Move the feet in the air."""
        gait, elapsed = self.gait, cycle.time - self._since
        left = max(gait.swing - elapsed, 0.0)
        self._follow(cycle)
        origin, turn = self._target(cycle, left)
        for name, swing in list(self._swings.items()):
            foot = self._feet[name]
            planned = self._landings.get(name)
            if planned is None or left > _FREEZE:
                place = origin + foot.nominal * turn  # the height of the first plan stays
                height = ground.height_at(place) if planned is None else planned.height
                self._landings[name] = Landing(place, height, 0.0, gait.swing)
            landing = self._landings[name]
            if cycle.dt > 0.0:
                swing = moved(swing, landing, gait.clearance, elapsed - cycle.dt, cycle.dt, descent=0.0)
            self._swings[name] = swing
            self._references[foot.task] = Reference(*swing[:, :3])
            share, late, sensor = elapsed / gait.swing, elapsed - gait.swing, self._sensor(name, cycle.touching)
            if share < COUNTS:
                continue
            wanted, velocity = swing[1, 2], foot.velocity(cycle.dynamics)
            if rebounds(wanted, velocity) or lands(share, late, wanted, velocity, sensor):
                decision.changes.append(EnableContact(name, True, 0.0))
                del self._swings[name]
        if not self._swings:
            self.steps += 1
            self._group = (self._group + 1) % len(gait.groups)
            self.phase, self._since = Phase.DOUBLE, cycle.time

    def _target(self, cycle: _Cycle, left: float) -> tuple[complex, complex]:
        """Return origin, x + i y in m, and turn e^{iψ} of the nominal places for a touchdown after a time in s."""
        gait = self.gait
        group = gait.groups[self._group]
        if len(group) == 2:
            stance = gait.swing + gait.pause[(self._group + 1) % len(gait.groups)]
            feet = [self._place(name) for name in self._feet if name not in group]
            velocity = self._in_world(left)
            dcm = SupportLine.through(*feet).later(cycle.dcm, velocity, cycle.omega, left)
            middle = middle_of_pair(dcm, self._in_world(left + 0.5 * stance), cycle.omega, stance)
            body = dcm - velocity / cycle.omega
            origin = 0.5 * sum(self._feet[name].nominal for name in group)
        else:
            stance = gait.cycle - gait.swing
            body = self._body + self._in_world(left) * left
            middle = body + 0.5 * stance * self._in_world(left + 0.5 * stance)
            origin = 0j
        turn = cmath.rect(1.0, self._heading + self.velocity.turning * (left + 0.5 * stance))
        away = middle - body
        away *= min(1.0, gait.length / max(abs(away), 1.0e-9))
        return body + away - origin * turn, turn

    def _in_world(self, ahead: float) -> complex:
        """Return the commanded velocity in the world after a time in s, m/s."""
        return self.velocity.linear * cmath.rect(1.0, self._heading + self.velocity.turning * ahead)

    def _double(self, cycle: _Cycle, decision: Decision) -> None:
        """Stand on all feet until the next swing, or stop."""
        elapsed, pause = cycle.time - self._since, self.gait.pause[self._group]
        self._follow(cycle)
        self._sway = move_axis(*self._sway, self.gait.sway[self._group], 0.0, pause - elapsed, cycle.dt)
        still = abs(self.velocity.linear) < _SLOW and abs(self.velocity.turning) < _SLOW
        if self.command is None and still and self._is_nominal():
            self._enter(Phase.STOP, cycle)
        elif elapsed >= pause:
            self._lift_off(cycle, decision)

    def _is_nominal(self) -> bool:
        middle, turn = self._middle(), cmath.rect(1.0, self._heading)
        return all(
            abs(self._place(name) - middle - turn * foot.nominal) < _NOMINAL for name, foot in self._feet.items()
        )

    def _follow(self, cycle: _Cycle) -> None:
        """Move the reference of the body with the commanded velocity, near the measured one."""
        self._body_velocity = self._in_world(0.0)
        self._body += self._body_velocity * cycle.dt
        lag = self._body + self._sway_in_world(self._sway[0]) - cycle.com
        if abs(lag) > _LAG:
            self._body -= lag * (1.0 - _LAG / abs(lag))

    def _sway_in_world(self, sway: float) -> complex:
        return sway * cmath.rect(1.0, self._heading + 0.5 * math.pi)

    def _move_body(self) -> None:
        """Set the reference of the centre of mass."""
        sway, rate, push = map(self._sway_in_world, self._sway)
        place, velocity = self._body + sway, self._body_velocity + rate
        self._references[self.tasks.balance] = Reference(
            np.array([place.real, place.imag, 0.0]),
            np.array([velocity.real, velocity.imag, 0.0]),
            np.array([push.real, push.imag, 0.0]),
        )
