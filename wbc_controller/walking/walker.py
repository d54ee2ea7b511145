"""The walker: phases of a biped's gait, and in every cycle the references that the controller follows."""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change, EnableContact, EnableTask, SetSetpoint
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array, Reference
from wbc_controller.walking.adaptation import StepTarget, adapted
from wbc_controller.walking.feet import Foot, Sole, about_z, mean_angle
from wbc_controller.walking.footsteps import NominalStep, Stance, Velocity, nominal_step
from wbc_controller.walking.gait import Gait, Phase
from wbc_controller.walking.pendulum import later, natural_frequency, transferred
from wbc_controller.walking.swing import Axis, Landing, SwingFoot
from wbc_controller.walking.terrain import FOOTHOLDS, Ground, plane_through
from wbc_controller.walking.touchdown import lands

#: Feedback gain on the DCM, 1/s.
GAIN = 5.0
#: Shares of the half length and half width of the sole that the centre of pressure may use.
_SOLE_SHARE = (0.8, 0.7)
#: Half length and half width of the area for the centre of pressure on two feet, around the planned one, m.
_TWO_FEET = (0.06, 0.05)
#: Time in which the reference of the DCM blends from one phase to the next, s.
_BLEND = 0.2
#: Time before touchdown from which on the target of the step stays, s.
_FREEZE = 0.05
#: Difference between planned and real touchdown on flat ground, s, and shortest double support, s.
_ON_TIME, _SHORTEST_DOUBLE = 0.02, 0.02
#: Time constant with which the swing foot turns to the slope of the ground, s.
_LEVELLING = 0.05
#: Rates at which height and heading follow their goals, 1/s, and the largest rate of the height, m/s.
_HEIGHT_RATE, _HEADING_RATE, _FASTEST_HEIGHT = 3.0, 6.0, 0.2
#: Largest distance between the feet along the heading for a stop, m, and largest speed, m/s.
_BESIDE, _SLOW = 0.02, 0.02


@dataclass(frozen=True, slots=True)
class WalkingTasks:
    """Names of the tasks that the walker commands.

    Attributes:
        dcm: task on the DCM (`CapturePointTask`).
        height: task on the height of the centre of mass.
        posture: task on the joints, stiffer than that for standing: the arms must not swing with the legs.
        orientations: tasks on orientations that turn with the heading.
        suspended: tasks with references in the world, which are off while walking.
    """

    dcm: str
    height: str
    posture: str
    orientations: tuple[str, ...]
    suspended: tuple[str, ...]


@dataclass(slots=True)
class Decision:
    """Changes and references that the walker requests in one cycle.

    Attributes:
        changes: changes of tasks and contacts.
        references: references of tasks in this cycle.
    """

    changes: list[Change] = field(default_factory=list)
    references: dict[str, Reference] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """A single support: its stance, the nominal step, its adaptation, the planned touchdown, and the swing foot.

    Attributes:
        ground: plane through the last footholds.
        slope: of the swing foot, dz/dx + i dz/dy.
    """

    stance: Stance
    nominal: NominalStep
    target: StepTarget
    landing: Landing
    swing: SwingFoot
    ground: Ground
    slope: complex


@dataclass(frozen=True, slots=True)
class _Cycle:
    """The state of one cycle."""

    time: float  # s
    dt: float  # time since the last cycle, s
    dcm: complex  # ξ, x + i y in m
    omega: float  # ω, 1/s
    soles: Mapping[int, Sole]  # by side: 1 left, -1 right
    forces: Mapping[str, float]  # measured normal forces, by contact, N
    landing: Array  # velocity of the foot that does not bear the weight, (3,) in m/s


class Walker:
    """Turns a velocity command into steps.

    Call `update` in every cycle with the dynamics at the present state, before the references are sampled.

    Attributes:
        gait: parameters of the gait.
        phase: phase of the gait.
        command: commanded velocity; None to stand.
        leaving: True if the controller is deactivated as soon as the robot stands; until then no command is taken.
        velocity: velocity on the way to it.
        steps: number of steps since the start.
    """

    STATE_FIELDS = (
        "phase", "command", "leaving", "velocity", "steps", "_until", "_since", "_last", "_stance", "_clearance",
        "_height", "_heading", "_orientations", "_step", "_blend", "_dcm_wanted", "_touchdown", "_references",
        "_footholds", "_early", "_double_support",
    )  # fmt: skip

    def __init__(self, gait: Gait, left: Foot, right: Foot, tasks: WalkingTasks, gravity: float) -> None:
        """Make a walker that stands; gravity in m/s²."""
        self.gait = gait
        self._feet = {1: left, -1: right}
        self._tasks = tasks
        self._own_tasks = (tasks.dcm, tasks.height, tasks.posture, left.task, right.task)
        self._gravity = gravity
        self.reset()

    def reset(self) -> None:
        """Stand, without a command."""
        self.phase = Phase.STAND
        self.command: Velocity | None = None
        self.leaving = False
        self._until = math.inf  # time at which the command ends, s
        self.velocity = Velocity()
        self.steps = 0
        self._since = self._last = 0.0  # begin of the phase, and last cycle, s
        self._stance = -1  # side of the foot that bears the weight
        self._clearance = 0.0  # wanted height of the centre of mass above the stance foot, m
        self._height = self._heading = 0.0  # references of its height in the world, m, and of the heading, rad
        self._orientations: dict[str, Array] = {}  # references of the tasks at the heading 0, (3, 3)
        self._step: Step | None = None
        self._dcm_wanted = 0j
        self._blend = 0j  # reference of the DCM at the begin of the phase; in a step, less that of the step
        self._touchdown: tuple[complex, ...] = (0j, 0j, 0j)  # DCM, old and new foot at touchdown
        self._references: dict[str, Reference] = {}  # of the last cycle, by task
        self._early = self._double_support = 0.0  # time until the planned touchdown, and until lift-off after it, s
        self._footholds: tuple[Ground, ...] = ()  # the last ones, newest first

    def ask(self, command: Velocity | None, until: float = math.inf) -> None:
        """Walk at a velocity until a time in s; None to stand.

        Raises:
            InputRefused: if the robot stops because the controller is deactivated.
        """
        if self.leaving and command is not None:
            raise InputRefused("the command to walk is refused: the robot stops walking before it is deactivated")
        self.command, self._until = command, until

    def leave(self) -> None:
        """Stop walking, for the controller to be deactivated when the robot stands."""
        self.ask(None)
        self.leaving = True

    @property
    def moves(self) -> bool:
        """True while the robot walks or is about to."""
        return self.phase is not Phase.STAND or self.command is not None

    @property
    def orientations(self) -> tuple[str, ...]:
        """Names of the tasks on orientations that turn with the heading."""
        return self._tasks.orientations

    def update(
        self, time: float, dynamics: Dynamics, orientations: Mapping[str, Array], forces: Mapping[str, float]
    ) -> Decision:
        """Decide on contacts and references of one cycle.

        Args:
            time: of the state, s.
            dynamics: at this state.
            orientations: present references of the tasks on orientations, as quaternions (x, y, z, w), by name.
            forces: measured normal forces of contacts, N; of a foot without one, its motion tells the touchdown.
        """
        decision, dt = Decision(), time - self._last
        self._last = time
        if time > self._until:
            self.command = None
        soles = {side: foot.sole(dynamics) for side, foot in self._feet.items()}
        if self.phase is Phase.STAND:
            if self.command is None:
                return decision
            dt = 0.0
            self._begin(float(dynamics.com[2]), soles, orientations, decision)
        omega = natural_frequency(self._clearance, self._gravity)
        com = dynamics.com + dynamics.com_velocity / omega
        cycle = _Cycle(
            time=time,
            dt=dt,
            dcm=complex(com[0], com[1]),
            omega=omega,
            soles=soles,
            forces=forces,
            landing=self._feet[-self._stance].velocity(dynamics),
        )
        wanted = Velocity() if self.command is None else self.command.clipped(self.gait)
        self.velocity = self.velocity.towards(wanted, self.gait, dt)
        if self.phase is Phase.STAND:
            self._enter(Phase.SHIFT, cycle)
        if self.phase is Phase.SINGLE and self._step is not None:
            pressure = self._single(self._step, cycle, decision)
        elif self.phase is Phase.DOUBLE:
            pressure = self._double(cycle, decision)
        else:
            pressure = self._shift(cycle, decision)
        if self.phase is Phase.STAND:
            return decision
        rate = omega * (cycle.dcm - pressure)
        self._references[self._tasks.dcm] = _reference([cycle.dcm.real, cycle.dcm.imag], [rate.real, rate.imag])
        self._hold_height(soles[self._stance], dt)
        self._turn(soles, dt)
        decision.references = dict(self._references)
        return decision

    def _begin(
        self, height: float, soles: Mapping[int, Sole], orientations: Mapping[str, Array], decision: Decision
    ) -> None:
        """Start from standing, with the centre of mass at a height in m in the world."""
        ground = 0.5 * float(soles[1].centre[2] + soles[-1].centre[2])
        self._height, self._clearance = height, height - ground - self.gait.lowering
        self._heading = mean_angle(soles[1].heading, soles[-1].heading)
        ahead = about_z(-self._heading)
        self._orientations = {name: ahead @ rotation_of(quaternion) for name, quaternion in orientations.items()}
        self._references = {foot.task: foot.at_rest(soles[side]) for side, foot in self._feet.items()}
        self._footholds = tuple(sole.ground for sole in soles.values())
        self.steps, self.velocity, self._step = 0, Velocity(), None
        self._stance = 1 if self.command is not None and self.command.linear.imag < 0.0 else -1
        decision.changes += [EnableTask(name, False) for name in self._tasks.suspended]
        decision.changes += [EnableTask(name, True) for name in self._own_tasks]

    def _enter(self, phase: Phase, cycle: _Cycle) -> None:
        """Enter a phase; the reference of the DCM begins at the measured one."""
        self.phase, self._since, self._blend = phase, cycle.time, cycle.dcm

    def _shift(self, cycle: _Cycle, decision: Decision) -> complex:
        """Move the DCM to the begin of the first step, or for a stop to the middle; return the centre of pressure."""
        soles, elapsed, duration = cycle.soles, cycle.time - self._since, self.gait.shift
        foot = soles[self._stance]
        if self.phase is Phase.SHIFT:
            stance = Stance(foot.place, foot.heading, -self._stance, cycle.omega)
            nominal = nominal_step(Velocity(), stance, self.gait)
            goal = later(nominal.place + nominal.offset, stance.place, cycle.omega, -self.gait.single)
        else:
            goal = 0.5 * (soles[1].place + soles[-1].place)
        share, rate = _smooth(elapsed / duration)
        self._dcm_wanted = self._blend + (goal - self._blend) * share
        pressure = self._dcm_wanted - (goal - self._blend) * rate / (duration * cycle.omega)
        if self.phase is Phase.STOP and self.command is not None:
            self._enter(Phase.SHIFT, cycle)
        elif self.phase is Phase.SHIFT and self.command is None and elapsed < 0.5 * duration:
            self._enter(Phase.STOP, cycle)
        elif elapsed >= duration:
            self._lift_off(cycle, decision) if self.phase is Phase.SHIFT else self._stand(decision)
        return self._corrected(pressure, cycle, _TWO_FEET, foot.heading)

    def _stand(self, decision: Decision) -> None:
        """End walking: the tasks stay at their last references until they are off."""
        self.phase = Phase.STAND
        decision.changes += [SetSetpoint(name, each.position, 0.0) for name, each in self._references.items()]
        decision.changes += [EnableTask(name, False) for name in self._own_tasks]
        decision.changes += [EnableTask(name, True) for name in self._tasks.suspended]

    def _lift_off(self, cycle: _Cycle, decision: Decision) -> None:
        """Begin a single support."""
        foot, sole = cycle.soles[-self._stance], cycle.soles[self._stance]
        self.phase, self._since = Phase.SINGLE, cycle.time
        decision.changes.append(EnableContact(self._feet[-self._stance].contact, False, 0.0))
        stance = Stance(sole.place, sole.heading, -self._stance, cycle.omega)
        nominal = nominal_step(self.velocity, stance, self.gait)
        self._footholds = (sole.ground, *self._footholds[: FOOTHOLDS - 1])
        ground = plane_through(self._footholds)
        self._step = Step(
            stance=stance,
            nominal=nominal,
            target=StepTarget(nominal.place, nominal.offset, self.gait.single),
            landing=Landing(nominal.place, ground.height_at(nominal.place), nominal.heading),
            swing=SwingFoot(*(Axis(each) for each in (*foot.centre.tolist(), foot.heading))),
            ground=ground,
            slope=foot.ground.slope,
        )
        first = later(nominal.place + nominal.offset, stance.place, stance.omega, -self.gait.single)
        self._blend = self._dcm_wanted - first

    def _single(self, step: Step, cycle: _Cycle, decision: Decision) -> complex:
        """Adapt the step, and move the swing foot; return the centre of pressure."""
        gait, elapsed, dt = self.gait, cycle.time - self._since, cycle.dt
        stance, sole, foot = step.stance, cycle.soles[self._stance], self._feet[-self._stance]
        if step.target.time - elapsed > _FREEZE:
            nominal = nominal_step(self.velocity, stance, gait)
            target = adapted(step.target, nominal, stance, gait, cycle.dcm, step.swing.place, elapsed, dt)
            heading = step.swing.heading.position
            heading += math.remainder(nominal.heading - heading, math.tau)
            sunk = sole.ground.height - self._footholds[0].height  # since the lift-off, also by drift of the estimate
            landing = Landing(target.place, step.ground.height_at(target.place) + sunk, heading)
            step = replace(step, nominal=nominal, target=target, landing=landing)
        nominal, target = step.nominal, step.target
        share, _ = _smooth(elapsed / _BLEND)
        left = max(target.time - elapsed, 0.0)
        self._dcm_wanted = later(nominal.place + nominal.offset, stance.place, stance.omega, -left)
        self._dcm_wanted += self._blend * (1.0 - share)
        if dt > 0.0:
            swing = step.swing.moved(step.landing, gait.clearance, elapsed - dt, target.time, dt)
            slope = step.slope + (step.ground.slope - step.slope) * min(1.0, dt / _LEVELLING)
            step = replace(step, swing=swing, slope=slope)
        self._step = step
        self._references[foot.task] = foot.in_swing(step.swing, step.slope)
        late = elapsed - target.time
        touches = lands(
            elapsed / target.time, late, step.swing.z.velocity, cycle.landing, cycle.forces.get(foot.contact)
        )
        if touches:
            self._land(step, cycle, late, decision)
        length, width = self._feet[self._stance].half if not touches else foot.half
        return self._corrected(stance.place, cycle, (_SOLE_SHARE[0] * length, _SOLE_SHARE[1] * width), stance.heading)

    def _land(self, step: Step, cycle: _Cycle, late: float, decision: Decision) -> None:
        """Begin a double support: the swing foot bears weight where it is.

        The centre of pressure begins to move later if the foot lands early on higher ground, and arrives sooner if it
        lands late on lower ground: otherwise the DCM would differ from its plan.
        """
        foot, sole = self._feet[-self._stance], cycle.soles[-self._stance]
        decision.changes.append(EnableContact(foot.contact, True, 0.0))
        self._references[foot.task] = foot.at_rest(sole)
        self.phase, self._since, self.steps = Phase.DOUBLE, cycle.time, self.steps + 1
        self._early = max(0.0, -late - _ON_TIME)
        self._double_support = max(self.gait.double - max(0.0, late - _ON_TIME), _SHORTEST_DOUBLE)
        begin = later(cycle.dcm, step.stance.place, cycle.omega, self._early)
        self._touchdown = begin, step.stance.place, sole.place
        self._stance = -self._stance

    def _double(self, cycle: _Cycle, decision: Decision) -> complex:
        """Move the centre of pressure to the new foot; return it."""
        begin, old, new = self._touchdown
        duration, heading = self._double_support, cycle.soles[self._stance].heading
        elapsed = min(cycle.time - self._since - self._early, duration)
        if elapsed < 0.0:
            self._dcm_wanted, pressure = later(begin, old, cycle.omega, elapsed), old
        else:
            self._dcm_wanted = transferred(begin, old, new, duration, cycle.omega, elapsed)
            pressure = old + (new - old) * (elapsed / duration)
        beside = abs(((new - old) * cmath.rect(1.0, -heading)).real) < _BESIDE
        if self.command is None and beside and abs(self.velocity.linear) < _SLOW:
            self._enter(Phase.STOP, cycle)
        elif elapsed >= duration:
            self._lift_off(cycle, decision)
        return self._corrected(pressure, cycle, _TWO_FEET, heading)

    def _corrected(self, pressure: complex, cycle: _Cycle, half: tuple[float, float], heading: float) -> complex:
        """Return the centre of pressure that moves the DCM to its reference, within an area around the planned one.

        ξ̇ = ω (ξ - p) = ξ̇* - k (ξ - ξ*) needs p = p* + (1 + k / ω) (ξ - ξ*).
        """
        axes = cmath.rect(1.0, heading)
        change = (1.0 + GAIN / cycle.omega) * (cycle.dcm - self._dcm_wanted) / axes
        x = max(-half[0], min(half[0], change.real))
        y = max(-half[1], min(half[1], change.imag))
        return pressure + complex(x, y) * axes

    def _hold_height(self, stance: Sole, dt: float) -> None:
        """Follow the height of the ground under the stance foot."""
        short = float(stance.centre[2]) + self._clearance - self._height
        rate = max(-_FASTEST_HEIGHT, min(_FASTEST_HEIGHT, _HEIGHT_RATE * short))
        self._height += rate * dt
        self._references[self._tasks.height] = _reference([0.0, 0.0, self._height], [0.0, 0.0, rate])

    def _turn(self, soles: Mapping[int, Sole], dt: float) -> None:
        """Turn the tasks on orientations with the heading of the feet."""
        if self._step is None:
            goal = mean_angle(soles[1].heading, soles[-1].heading)
        else:
            goal = mean_angle(self._step.stance.heading, self._step.nominal.heading)
        rate = _HEADING_RATE * math.remainder(goal - self._heading, math.tau)
        self._heading += rate * dt
        turn = about_z(self._heading)
        for name, rotation in self._orientations.items():
            self._references[name] = _reference(quaternion_of(turn @ rotation), [0.0, 0.0, rate])


def _reference(position: object, velocity: list[float]) -> Reference:
    """Return a reference without acceleration."""
    rates = np.array(velocity)
    return Reference(np.array(position, dtype=np.float64), rates, np.zeros(len(rates)))


def _smooth(share: float) -> tuple[float, float]:
    """Return the quintic from 0 to 1 at a share of its duration, and its derivative."""
    s = max(0.0, min(1.0, share))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) ** 2
