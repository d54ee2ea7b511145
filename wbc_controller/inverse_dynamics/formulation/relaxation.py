"""Relaxation of conflicting limits."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.problem import SoftConstraints
from wbc_controller.records import Array, References

_VIOLATION_WEIGHT = 1.0e4  # (m/s²)⁻², or per squared effort limit
_JOINT_WEIGHT = 1.0e2  # (rad/s²)⁻²: equivalent at a lever of 0.1 m
_BRAKING_WEIGHT = 1.0  # of a joint that can still stop, (rad/s²)⁻²
#: Speeds, m/s and rad/s, of a slipping contact, and of a contact that cannot stop a joint.
_SLIP_SPEEDS, _LOOSE_SPEEDS = (1.0, 10.0), (0.5, 5.0)
_VIOLATION_TOLERANCE = 1.0e-3  # rad/s², m/s² or effort limits


@dataclass(frozen=True, slots=True)
class Relaxable:
    """Group of limits that can be relaxed together."""

    name: str  # as in `Solution.relaxed`
    places: np.ndarray  # in the bounds of the problem, (k,)
    units: Array  # of violations, (k,): 1 rad/s² or m/s², or the effort limit
    bounds: Array  # before relaxation, (2, k)
    hard: Array  # always hold, (2, k)
    soft: SoftConstraints  # in place of `bounds`

    @classmethod
    def of(
        cls, layout: Layout, name: str, places: np.ndarray, *, hard: Array | None = None, units: Array | None = None
    ) -> "Relaxable":
        """Describe limits of a built problem; units are 1 by default."""
        bounds = layout.problem.bounds[:, places]
        hard = np.repeat([[-np.inf], [np.inf]], len(places), axis=1) if hard is None else hard
        units = np.ones(len(places)) if units is None else units
        there = np.flatnonzero((bounds != hard).any(axis=0))
        places, units, bounds, hard = places[there], units[there], bounds[:, there], hard[:, there]
        asked = np.where(bounds != hard, bounds, [[-np.inf], [np.inf]])
        return cls(name, places, units, bounds, hard, SoftConstraints(places, asked, _VIOLATION_WEIGHT / units**2))


def relaxations(formulation: Formulation, layout: Layout, references: References) -> Iterator[list[Relaxable]]:
    """Yield groups of limits to relax: first the torque rate, then all limits except available torques."""
    n = layout.problem.n
    torques, hard = n + np.arange(layout.torque.stop), np.stack(formulation.effort_bounds(references))
    rate = Relaxable.of(layout, "torque_rate", torques, hard=hard, units=formulation.torque_limit.effort_limits)
    first = [rate] if len(rate.places) else []
    if first:
        yield first
    rows = [
        Relaxable.of(layout, limit.kind, n + np.arange(place.start, place.stop))
        for limit, place in zip(layout.row_limits, layout.limits, strict=True)
    ]
    yield first + [group for group in (*rows, _joint_motion_group(formulation, layout)) if len(group.places)]


def contacts_preventing_stop(formulation: Formulation, layout: Layout, value: Array) -> tuple[str, ...]:
    """Return the contacts that prevent a stop at a position limit, from a relaxed [x; C x].

    If the robot leaves the ground faster than a leg can extend, only release of its foot stops the knee.
    """
    most = formulation.motion_limit.acceleration
    needed, missed = _stopping_demand(formulation, layout, value)
    passing = layout.joints[missed > most]
    if not (needed > most).any():
        return ()
    places = [place for place in layout.places if not place.contact.permanent]
    apart = not all(any(layout.J[place.motion, joint].any() for place in places) for joint in passing)
    moving = slipping_contacts(formulation, layout, _LOOSE_SPEEDS)
    moved = [place.contact.name for place in places if layout.J[place.motion][:, passing].any()]
    return tuple(place.contact.name for place in places if apart or place.contact.name in (*moving, *moved))


def stopping_shortfall(formulation: Formulation, layout: Layout, value: Array) -> float:
    """Return the sum of missing joint accelerations for stops at position limits, rad/s²."""
    needed, missed = _stopping_demand(formulation, layout, value)
    return float(np.maximum(missed, 0.0)[needed > formulation.motion_limit.acceleration].sum())


def _stopping_demand(formulation: Formulation, layout: Layout, value: Array) -> tuple[Array, Array]:
    """Return required and missing accelerations for stops at position limits, both (nj,)."""
    joints = layout.joints
    lower, upper = _stopping_bounds(formulation, np.repeat([[np.inf], [-np.inf]], len(joints), axis=1))
    return np.maximum(lower, -upper), np.maximum(lower - value[joints], value[joints] - upper)


def slipping_contacts(
    formulation: Formulation, layout: Layout, speeds: tuple[float, float] = _SLIP_SPEEDS
) -> tuple[str, ...]:
    """Return the contacts that move faster than speeds in m/s and rad/s."""
    velocity, names = layout.J @ formulation.dynamics.v, []
    for place in layout.places:
        own, turns = velocity[place.motion], place.contact.moments
        moves = np.linalg.norm(own[~turns]) > speeds[0] or np.linalg.norm(own[turns]) > speeds[1]
        if moves and not place.contact.permanent:
            names.append(place.contact.name)
    return tuple(names)


def _stopping_bounds(formulation: Formulation, bounds: Array) -> Array:
    model, dynamics = formulation.model, formulation.dynamics
    return formulation.motion_limit.stopping_bounds(
        dynamics.q[model.q_places], dynamics.v[model.v_places], bounds, (model.position_lower, model.position_upper)
    )


def _joint_motion_group(formulation: Formulation, layout: Layout) -> Relaxable:
    joints = layout.joints
    stopping = _stopping_bounds(formulation, layout.problem.bounds[:, joints])
    brakes = np.isfinite(stopping).any(axis=0)
    group = Relaxable.of(layout, "joint_motion", joints)
    weights = np.where(np.isin(group.places, joints[brakes]), _BRAKING_WEIGHT, _JOINT_WEIGHT)
    bounds = SoftConstraints(group.soft.places, group.soft.bounds, weights)
    stops = SoftConstraints(joints[brakes], stopping[:, brakes], np.full(int(brakes.sum()), _JOINT_WEIGHT))
    return replace(group, soft=SoftConstraints.joined([bounds, stops]))


def soften(layout: Layout, groups: Sequence[Relaxable]) -> SoftConstraints:
    """Keep only the hard bounds of groups in the problem, and return their soft constraints."""
    for group in groups:
        layout.problem.bounds[:, group.places] = group.hard
    return SoftConstraints.joined([group.soft for group in groups])


def widen(layout: Layout, groups: Sequence[Relaxable], value: Array, room: float) -> tuple[str, ...]:
    """Set bounds to the original ones, widened to [x; C x] plus `room`; return the groups with a violated bound."""
    bounds, violated = layout.problem.bounds, []
    for group in groups:
        at, (lower, upper) = value[group.places], group.bounds
        bounds[0, group.places], bounds[1, group.places] = np.minimum(lower, at - room), np.maximum(upper, at + room)
        if (np.maximum(lower - at, at - upper) > _VIOLATION_TOLERANCE * group.units).any():
            violated.append(group.name)
    return tuple(dict.fromkeys(violated))
