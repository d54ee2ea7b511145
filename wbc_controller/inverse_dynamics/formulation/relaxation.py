"""Which limits give way if they cannot all be met, and what it costs to miss them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.formulation.layout import ContactPlace, Layout
from wbc_controller.inverse_dynamics.formulation.problem import Soft
from wbc_controller.records import Array, References

#: Weight of what is missed, squared: (m/s²)⁻², and for torques per squared effort limit.
_MISSED = 1.0e4
#: Likewise of joint accelerations, (rad/s²)⁻²: the same at an end of 0.1 m.
_JOINT = 1.0e2
#: Weight of the bounds of a joint that can still stop in time, (rad/s²)⁻²: about that of tasks, so that a robot whose
#: knees have to brake keeps its balance.
_BRAKING = 1.0
#: Speeds in m/s and rad/s from which a contact holds nothing any more, whatever it is meant to do, and from which it
#: stops no joint that has to brake hard.
_LOST, _LOOSE = (1.0, 10.0), (0.5, 5.0)
#: A bound that is missed by less does not count as relaxed: rad/s², m/s² or effort limits.
_MET = 1.0e-3


@dataclass(frozen=True, slots=True)
class Relaxable:
    """A group of limits that can be relaxed."""

    name: str  # as in `Solution.relaxed`
    places: np.ndarray  # of the limits in the bounds of the problem, (k,)
    units: Array  # violations that count alike, (k,): 1 rad/s² or m/s², and the effort limits for torques
    bounds: Array  # the lower and upper bounds as built, (2, k)
    hard: Array  # the lower and upper bounds that always hold, (2, k); -inf and inf where there is none
    soft: Soft  # what is asked for in their place

    @classmethod
    def of(
        cls, layout: Layout, name: str, places: np.ndarray, *, hard: Array | None = None, units: Array | None = None,
        weight: float = _MISSED,
    ) -> Relaxable:  # fmt: skip
        """Describe limits of a built problem; by default, no hard bounds and units of 1."""
        bounds = layout.problem.bounds[:, places]
        hard = np.repeat([[-np.inf], [np.inf]], len(places), axis=1) if hard is None else hard
        units = np.ones(len(places)) if units is None else units
        there = np.flatnonzero((bounds != hard).any(axis=0))
        places, units, bounds, hard = places[there], units[there], bounds[:, there], hard[:, there]
        asked = np.where(bounds != hard, bounds, [[-np.inf], [np.inf]])
        return cls(name, places, units, bounds, hard, Soft(places, asked, weight / units**2))

    def missed(self, value: Array) -> bool:
        """Whether a bound is missed by values of x and C x, (n + m_in,)."""
        at = value[self.places]
        return bool((np.maximum(self.bounds[0] - at, at - self.bounds[1]) > _MET * self.units).any())


def relaxations(formulation: Formulation, layout: Layout, references: References) -> Iterator[list[Relaxable]]:
    """The groups of limits that can be relaxed together in a built problem, the least first.

    First the torque rate alone, where it narrows the available torques; then all limits but the available torques.
    """
    n = layout.problem.n
    rate = Relaxable.of(
        layout,
        "torque_rate",
        n + np.arange(layout.torque.start, layout.torque.stop),
        hard=np.stack(formulation.effort_bounds(references)),
        units=formulation.torque_limit.effort_limits,
    )
    first = [rate] if len(rate.places) else []
    if first:
        yield first
    rows = [
        Relaxable.of(layout, limit.kind, n + np.arange(place.start, place.stop))
        for limit, place in zip(layout.row_limits, layout.limits, strict=True)
    ]
    yield first + [group for group in (*rows, _motion(formulation, layout)) if len(group.places)]


def hindering_contacts(formulation: Formulation, layout: Layout, value: Array) -> tuple[str, ...]:
    """Names of the active contacts that keep a joint from stopping at its position limit.

    A foot that is taken to stand determines the motion of its leg, and where the robot leaves the ground faster than a
    leg is long, no torque stops the knee: the foot has to go along. A foot that moves already stops no joint either,
    though the problem takes it to. An arm is not a part of a leg, but may be what keeps the robot on its feet.

    Args:
        value: x and C x of its relaxed solution, (n + m_in,).
    """
    most = formulation.motion_limit.acceleration
    needed, missed = _stops(formulation, layout, value)
    passing = layout.joints[missed > most]
    if not (needed > most).any():
        return ()
    places = [place for place in layout.places if not place.contact.permanent]
    apart = not all(any(layout.J[place.motion, joint].any() for place in places) for joint in passing)
    moving = _moving(formulation, layout, _LOOSE)
    moved = [place.contact.name for place in places if layout.J[place.motion][:, passing].any()]
    return tuple(place.contact.name for place in places if apart or place.contact.name in (*moving, *moved))


def stops_missed(formulation: Formulation, layout: Layout, value: Array) -> float:
    """By how much the joints together miss the accelerations that stop them at their position limits, rad/s²."""
    needed, missed = _stops(formulation, layout, value)
    return float(np.maximum(missed, 0.0)[needed > formulation.motion_limit.acceleration].sum())


def _stops(formulation: Formulation, layout: Layout, value: Array) -> tuple[Array, Array]:
    """For each joint what it needs to stop at its limit, and what it lacks in a solution, (nj,) each, in rad/s²."""
    joints = layout.joints
    lower, upper = _stopping(formulation, np.repeat([[np.inf], [-np.inf]], len(joints), axis=1))
    return np.maximum(lower, -upper), np.maximum(lower - value[joints], value[joints] - upper)


def lost_contacts(formulation: Formulation, layout: Layout) -> tuple[str, ...]:
    """Names of the active contacts that move so fast that they hold nothing."""
    return _moving(formulation, layout, _LOST)


def _moving(formulation: Formulation, layout: Layout, speeds: tuple[float, float]) -> tuple[str, ...]:
    """Names of the active contacts that can be given up and move faster than one of two speeds in m/s and rad/s."""
    velocity = layout.J @ formulation.dynamics.v
    places = [place for place in layout.places if not place.contact.permanent]
    return tuple(place.contact.name for place in places if _faster(place, velocity[place.motion], speeds))


def _faster(place: ContactPlace, velocity: Array, speeds: tuple[float, float]) -> bool:
    turns = place.contact.moments
    return float(np.linalg.norm(velocity[~turns])) > speeds[0] or float(np.linalg.norm(velocity[turns])) > speeds[1]


def _stopping(formulation: Formulation, bounds: Array) -> Array:
    """Bounds with which joints still stop at their position limits (`JointMotionLimit.stopping_bounds`)."""
    model, dynamics = formulation.model, formulation.dynamics
    return formulation.motion_limit.stopping_bounds(
        dynamics.q[model.q_places], dynamics.v[model.v_places], bounds, (model.position_lower, model.position_upper)
    )


def _motion(formulation: Formulation, layout: Layout) -> Relaxable:
    """Joint motion: how early a joint brakes counts as much as tasks; that it stops in time, and all else, more."""
    joints = layout.joints
    stopping = _stopping(formulation, layout.problem.bounds[:, joints])
    brakes = np.isfinite(stopping).any(axis=0)
    group = Relaxable.of(layout, "joint_motion", joints)
    weights = np.where(np.isin(group.places, joints[brakes]), _BRAKING, _JOINT)
    bounds = Soft(group.soft.places, group.soft.bounds, weights)
    stops = Soft(joints[brakes], stopping[:, brakes], np.full(int(brakes.sum()), _JOINT))
    return replace(group, soft=bounds.with_more(stops))


def soften(layout: Layout, groups: Sequence[Relaxable]) -> Soft:
    """Leave only the hard bounds of groups in the problem, and give what is asked for in place of the others."""
    soft = groups[0].soft
    for group in groups:
        layout.problem.bounds[:, group.places] = group.hard
    for group in groups[1:]:
        soft = soft.with_more(group.soft)
    return soft


def widen(layout: Layout, groups: Sequence[Relaxable], value: Array, room: float) -> tuple[str, ...]:
    """Set the bounds of groups in the problem to what was built, widened to what was missed.

    Args:
        value: x and C x, (n + m_in,).
        room: distance that is left between these values and the widened bounds.

    Returns:
        The names of the groups in which a bound was missed.
    """
    bounds = layout.problem.bounds
    for group in groups:
        at = value[group.places]
        bounds[0, group.places] = np.minimum(group.bounds[0], at - room)
        bounds[1, group.places] = np.maximum(group.bounds[1], at + room)
    return tuple(dict.fromkeys(group.name for group in groups if group.missed(value)))
