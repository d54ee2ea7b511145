"""Limit that keeps the robot's links at a distance from each other."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.limits.limit import RowLimit
from wbc_controller.inverse_dynamics.limits.self_collision_kernels import ShapePairs, distance_rows, near_pairs
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, moved_by
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Speed at which links nearer than the margin separate, m/s: slow, as the robot may start there.
RETURN_SPEED = 0.1
#: Room kept above the margin for the approximations of the rows, m: the largest observed error is 1.2 mm.
INEXACT = 0.002
#: Largest required acceleration, as a multiple of the deceleration A, where braking with A was not enough.
_RESERVE = 3.0
#: Largest increase of a pair's closing speed in a cycle without a row, m/s: a row is left out if its lower bound of d̈
#: is below minus this over T.
_FASTER = 0.2
#: Tolerance of the distances, m, and the initial guess of their iteration: a direction, and two vertices.
_GJK_TOLERANCE = 1.0e-10
_GUESS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
#: The name of unused rows.
_UNUSED = "self_collision:unused"


class SelfCollisionLimit(RowLimit):
    """Rows J_d v̇ ≥ lower for the pairs of links that could otherwise come nearer than the margin.

    With d the distance of two convex shapes, and n the unit vector from the nearest point p₁ on the first shape to the
    nearest point p₂ on the second,

        ḋ = nᵀ (v₂(p₂) - v₁(p₁)) = J_d v,    d̈ ≥ J_d v̇ + δ.

    v₁, v₂ are the velocities of the links at these points. δ is nᵀ (a₂ - a₁) at v̇ = 0, with one exception: the
    centripetal acceleration about a shape's own origin counts only where it brings the links nearer. As the nearest
    points slide on the shapes, its separating part is smaller in reality, and zero for balls. The contribution of the
    tangential velocity only separates the links, and is left out.

    The closing speed w = -ḋ at the end of a period is bounded so that the links can stop before the margin. With A the
    deceleration, T the horizon and r = d - margin - 2 mm - w T the room that is left after T,

        w² / (2 A) + w T ≤ r,    so    d̈ ≥ (w - √(A² T² + 2 A r) + A T) / T.

    This is the law of `JointMotionLimit` with twice the allowance for the last period, so that near the margin r decays
    like a critically damped spring with the time constant T: an error e in δ costs a distance of e T². Where r < 0 the
    links have to separate with the speed -r / T, at most `RETURN_SPEED`. No row requires more than `_RESERVE` A.

    The pairs that could reach the margin are found in two steps. First, lower bounds of the distance of every pair: the
    last computed distance, less the rotation since then of each joint between the two links times the largest distance
    of the links' geometry from that joint; and the distance of balls that enclose the shapes. Then the distance itself,
    but only where a pair could not brake from its largest possible closing speed within the lower bound. The rows are
    the same as if all distances had been computed. If there are more pairs than rows, the pairs with the largest
    required d̈ get a row.

    Attributes:
        margin: least distance, m.
        acceleration: A, m/s².
        horizon: T, s; the period is used where it is longer.
        computed: number of distances computed in the last cycle.
    """

    kind = "self_collision"
    unit = "m/s²"

    def __init__(
        self,
        model: RobotModel,
        geometry: pin.GeometryModel,
        *,
        margin: float,
        acceleration: float,
        horizon: float,
        max_pairs: int,
        summary: str = "",
    ) -> None:
        """Make a limit for the pairs of convex shapes in a geometry; `max_pairs` is the number of rows."""
        self.summary = summary
        self.margin = margin
        self.acceleration = acceleration
        self.horizon = horizon
        self.names = (_UNUSED,) * max_pairs
        self._geometry = geometry
        self._data = geometry.createData()
        self._requests = [self._data.distanceRequests[i] for i in range(len(geometry.collisionPairs))]
        for request in self._requests:
            request.gjk_tolerance = _GJK_TOLERANCE
            request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
        shapes, moves = list(geometry.geometryObjects), moved_by(model.pinocchio)
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        self._pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self._pair_names = tuple(f"self_collision:{shapes[a].name}/{shapes[b].name}" for a, b in self._pairs)
        links = np.array([shape.parentJoint for shape in shapes], dtype=np.int64)
        radii = [_radius(shape.geometry) for shape in shapes]
        reach = np.array([_reach(model.pinocchio, *shape) for shape in zip(shapes, radii, strict=True)])
        starts, components, levers, ends = _levers(moves, links, reach, self._pairs)
        count = len(self._pairs)
        self._distances, self._normals = np.full(count, np.nan), np.zeros((count, 3))
        self._nearest = np.zeros((2, count, 3))  # nearest points on the first and the second shape of each pair
        self._near, self._reach, self._least = np.zeros(count, dtype=np.int64), np.zeros(count), np.full(count, np.nan)
        #: Fields of `ShapePairs` beside a snapshot's motion.
        self._fields = {
            "shape_links": links,
            "mounts": np.column_stack([[shape.placement.translation for shape in shapes], radii]),
            "pairs": self._pairs,
            "starts": starts,
            "components": components,
            "levers": levers,
            "places": _places(model.pinocchio),
            "ends": ends,
            "faster": _FASTER,
            "normals": self._normals,
            "first": self._nearest[0],
            "second": self._nearest[1],
            "seen": np.full(model.nq, np.nan),
            "least": self._least,
            "sums": np.zeros((len(levers) + 1, 2)),
            "near": self._near,
            "reach": self._reach,
        }
        self._table: ShapePairs | None = None
        self._shown: list[int] = []  # the pairs of the rows
        self.computed = 0

    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write the rows and bounds for one state.

        The rows are in the order of the pairs: while the set of pairs stays the same each pair keeps its row, and the
        solver its warm start. If there are more pairs than rows, those with the largest required d̈ have a row.
        """
        rows[:], lower[:], upper[:] = 0.0, -np.inf, np.inf
        ahead = max(period, self.horizon)
        near = self._find(dynamics, ahead)
        near = near[~(self._distances[near] > self._reach[: len(near)])]
        shown: list[int] = []
        if len(near):
            J, rate, drift = self._rows(dynamics, near)
            bound = self.bound(self._distances[near], rate, ahead)
            needed = np.flatnonzero(~(bound < -_FASTER / ahead))
            bound = bound[needed] - drift[needed]
            most = np.sort(np.argsort(-bound, kind="stable")[: len(lower)])
            rows[: len(most)], lower[: len(most)] = J[needed[most]], bound[most]
            shown = near[needed[most]].tolist()
        if shown != self._shown or len(self.names) != len(lower):
            self._shown = shown
            names = [self._pair_names[i] for i in shown]
            self.names = (*names, *(_UNUSED,) * (len(lower) - len(names)))

    def bound(self, distance: Array, rate: Array, ahead: float) -> Array:
        """Lower bound of d̈, (k,) in m/s², that leaves room to stop before the margin: (-ḋ - w_max) / T.

        Distances d, (k,) in m; rates ḋ, (k,) in m/s; `ahead` is T, s. NaN if d or ḋ is.
        """
        A, room = self.acceleration, distance - (self.margin + INEXACT) + ahead * rate
        reach = A * ahead
        braking = np.sqrt(reach**2 + 2.0 * A * np.maximum(room, 0.0)) - reach
        fastest = np.where(room > 0.0, braking, np.maximum(room / ahead, -RETURN_SPEED))
        return np.minimum((-rate - fastest) / ahead, _RESERVE * A)

    def distances(self, dynamics: Dynamics) -> dict[str, float]:
        """Distance of every pair at one state, m, by row name."""
        dynamics.place(self._geometry, self._data)
        return {name: float(self._distance(i).min_distance) for i, name in enumerate(self._pair_names)}

    def _distance(self, pair: int) -> coal.DistanceResult:
        """Distance of a pair at the present placements of the shapes."""
        # Always from the same initial guess, so that the result does not depend on earlier queries, to the last digit.
        request = self._requests[pair]
        request.cached_gjk_guess, request.cached_support_func_guess = _GUESS
        return pin.computeDistance(self._geometry, self._data, pair)

    def _find(self, dynamics: Dynamics, ahead: float) -> np.ndarray:
        """Compute the distances of the pairs that may need a row, and return these pairs in order."""
        table = self._bind(dynamics)
        count = near_pairs(table, dynamics.q, dynamics.v, self.acceleration, ahead, self.margin + INEXACT)
        self.computed, near = count, self._near[:count]
        if count:
            dynamics.place(self._geometry, self._data)
        for i in near.tolist():
            result = self._distance(i)
            self._distances[i] = self._least[i] = result.min_distance
            self._normals[i] = result.normal
            self._nearest[0, i], self._nearest[1, i] = result.getNearestPoint1(), result.getNearestPoint2()
        return near

    def _rows(self, dynamics: Dynamics, pairs: np.ndarray) -> tuple[Array, Array, Array]:
        """Return J_d, (k, nv), ḋ, (k,) in m/s, and δ, (k,) in m/s², of pairs whose distances have been computed."""
        rows, rates, drifts = np.empty((len(pairs), dynamics.model.nv)), np.empty(len(pairs)), np.empty(len(pairs))
        distance_rows(self._bind(dynamics), pairs, rows, rates, drifts)
        return rows, rates, drifts

    def _bind(self, dynamics: Dynamics) -> ShapePairs:
        """Return the pairs for a snapshot."""
        if self._table is None or self._table.motion is not dynamics.motion:
            self._table = ShapePairs(motion=dynamics.motion, **self._fields)
        return self._table


def _levers(
    moves: np.ndarray, links: np.ndarray, reach: Array, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Array, np.ndarray]:
    """Speed of the distance of shapes on two links per speed of the joints between the links.

    A joint that moves one link of a pair and not the other changes their distance at most by its speed times the
    largest distance from it of the shape on that link. For a shape these are the joints from its link towards the root,
    up to the first one that moves both links: a part of the same sum for all of its pairs.

    `moves` is 1 where a component of v moves a link, (links, nv); `links` is the index of the link of each shape,
    (s,), `reach` the largest distance of each shape from each joint, (s, nv), and `pairs` the two shapes of each pair.
    The results are `starts`, `components`, `levers` and `ends` of `limits.self_collision_kernels.near_pairs`.
    """
    starts, components, levers, ends = [0], [], [], np.zeros(pairs.shape, dtype=np.int64)
    for shape, link in enumerate(links):
        own = np.flatnonzero(moves[link])[::-1]  # Pinocchio numbers them from the root on
        where = pairs == shape
        others = links[pairs[:, ::-1][where]]
        counts = np.count_nonzero(moves[others][:, own] == 0, axis=1)
        ends[where] = np.where(counts > 0, starts[-1] + counts, 0)
        own = own[: counts.max(initial=0)]
        components.append(own)
        levers.append(reach[shape, own])
        starts.append(starts[-1] + len(own))
    return np.array(starts, dtype=np.int64), np.concatenate(components), np.concatenate(levers), ends


def _places(model: pin.Model) -> np.ndarray:
    """Where the position of each joint with one degree of freedom stands in q, by component of v; else -1; (nv,)."""
    places = np.full(model.nv, -1, dtype=np.int64)
    for joint in model.joints:
        if joint.nq == joint.nv == 1:
            places[joint.idx_v] = joint.idx_q
    return places


def _reach(model: pin.Model, shape: pin.GeometryObject, radius: float) -> Array:
    """Largest distance of a shape from each joint that carries it, (nv,) in m; 1 for prismatic joints."""
    reach = np.zeros(model.nv)
    far = float(np.linalg.norm(shape.placement.translation)) + radius
    joint = shape.parentJoint
    while joint > 0:
        kind = model.joints[joint]
        slides = kind.nq == 1 and "Prismatic" in kind.shortname()
        reach[kind.idx_v : kind.idx_v + kind.nv] = 1.0 if slides else far
        travel = max(abs(model.lowerPositionLimit[kind.idx_q]), abs(model.upperPositionLimit[kind.idx_q]))
        far += float(np.linalg.norm(model.jointPlacements[joint].translation)) + (travel if slides else 0.0)
        joint = model.parents[joint]
    return reach


def _radius(geometry: Any) -> float:
    """Radius of a ball about a shape's origin that encloses the shape, m."""
    geometry.computeLocalAABB()
    return float(np.linalg.norm(geometry.aabb_center)) + float(geometry.aabb_radius)
