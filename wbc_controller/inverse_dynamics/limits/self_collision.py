"""Minimum distance between links."""

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.limits import self_collision_kernels as kernels
from wbc_controller.inverse_dynamics.limits.limit import RowLimit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, support_matrix
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

RETURN_SPEED = 0.1  # of links nearer than the margin, m/s: slow, as the robot may start there
ROW_ERROR = 0.002  # approximation error of the rows, m; observed up to 1.2 mm
_LARGEST_DEMAND = 3.0  # acceleration, in multiples of A
_GJK_TOLERANCE = 1.0e-10  # m
_GUESS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
_UNUSED = "self_collision:unused"


class SelfCollisionLimit(RowLimit):
    """Rows J_d v̇ ≥ lower for pairs of links that could come nearer than the margin.

    With the distance d of two convex shapes, and the unit vector n from the nearest point p₁ on the first shape to p₂
    on the second,

        ḋ = nᵀ (v₂(p₂) - v₁(p₁)) = J_d v,    d̈ ≥ J_d v̇ + δ.

    v₁, v₂ are the velocities of the links, and δ = nᵀ (a₂ - a₁) at v̇ = 0, without separating centripetal and tangential
    terms, as the nearest points slide.

    The closing speed w = -ḋ after a period must allow a stop before the margin. With the deceleration A, the horizon T
    and the remaining distance r = d - margin - 2 mm - w T,

        w² / (2 A) + w T ≤ r,    so    d̈ ≥ (w - √(A² T² + 2 A r) + A T) / T.

    Near the margin, r decays like a critically damped spring with the time constant T; an error e of δ costs a distance
    of e T². For r < 0 the links separate with the speed -r / T, at most `RETURN_SPEED`. Rows require at most
    `_LARGEST_DEMAND` A.

    Distances are computed only if a pair could not brake within a lower bound (`near_pairs`). With more pairs than
    rows, the largest required d̈ have rows.
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
        self.summary = summary
        self.margin = margin  # least distance, m
        self.acceleration = acceleration  # A, m/s²
        self.horizon = horizon  # lower bound of T, s
        self.computed = 0  # number of distances in the last cycle
        self.names = (_UNUSED,) * max_pairs
        self._geometry = geometry
        self._data = geometry.createData()
        self._requests = [self._data.distanceRequests[i] for i in range(len(geometry.collisionPairs))]
        for request in self._requests:
            request.gjk_tolerance = _GJK_TOLERANCE
            request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
        shapes, moves = list(geometry.geometryObjects), support_matrix(model.pinocchio)
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        self._pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self._pair_names = tuple(f"self_collision:{shapes[a].name}/{shapes[b].name}" for a, b in self._pairs)
        links = np.array([shape.parentJoint for shape in shapes], dtype=np.int64)
        for shape in shapes:
            shape.geometry.computeLocalAABB()
        boxes = [shape.geometry for shape in shapes]
        radii = [float(np.linalg.norm(box.aabb_center)) + float(box.aabb_radius) for box in boxes]
        reach = np.array([_reach(model.pinocchio, *shape) for shape in zip(shapes, radii, strict=True)])
        starts, components, levers, ends = _levers(moves, links, reach, self._pairs)
        count = len(self._pairs)
        self._distances = np.full(count, np.nan)
        self._shapes = kernels.ShapePairs(
            shape_links=links,
            mounts=np.column_stack([[shape.placement.translation for shape in shapes], radii]),
            pairs=self._pairs,
            starts=starts,
            components=components,
            levers=levers,
            places=_places(model.pinocchio),
            ends=ends,
            normals=np.zeros((count, 3)),
            first=np.zeros((count, 3)),
            second=np.zeros((count, 3)),
            seen=np.full(model.nq, np.nan),
            least=np.full(count, np.nan),
            sums=np.zeros((len(levers) + 1, 2)),
            near=np.zeros(count, dtype=np.int64),
            reach=np.zeros(count),
        )
        self._row_pairs: list[int] = []

    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write rows and bounds in the constant order of the pairs."""
        rows[:], lower[:], upper[:] = 0.0, -np.inf, np.inf
        ahead = max(period, self.horizon)
        near = self._compute_near_distances(dynamics, ahead)
        near = near[~(self._distances[near] > self._shapes.reach[: len(near)])]
        shown: list[int] = []
        if len(near):
            J, rate, drift = self._rows(dynamics, near)
            bound = self.bound(self._distances[near], rate, ahead)
            needed = np.flatnonzero(~(bound < -kernels.SPEED_INCREASE / ahead))
            bound = bound[needed] - drift[needed]
            most = np.sort(np.argsort(-bound, kind="stable")[: len(lower)])
            rows[: len(most)], lower[: len(most)] = J[needed[most]], bound[most]
            shown = near[needed[most]].tolist()
        if shown != self._row_pairs or len(self.names) != len(lower):
            self._row_pairs = shown
            names = [self._pair_names[i] for i in shown]
            self.names = (*names, *(_UNUSED,) * (len(lower) - len(names)))

    def bound(self, distance: Array, rate: Array, ahead: float) -> Array:
        """Return the lower bound of d̈, (-ḋ - w_max) / T, (k,), from distances d, rates ḋ and the horizon T."""
        A, room = self.acceleration, distance - (self.margin + ROW_ERROR) + ahead * rate
        reach = A * ahead
        braking = np.sqrt(reach**2 + 2.0 * A * np.maximum(room, 0.0)) - reach
        fastest = np.where(room > 0.0, braking, np.maximum(room / ahead, -RETURN_SPEED))
        return np.minimum((-rate - fastest) / ahead, _LARGEST_DEMAND * A)

    def distances(self, dynamics: Dynamics) -> dict[str, float]:
        """Return the distance of every pair at one state, m, by row name."""
        dynamics.place(self._geometry, self._data)
        return {name: float(self._distance(i).min_distance) for i, name in enumerate(self._pair_names)}

    def _distance(self, pair: int) -> coal.DistanceResult:
        request = self._requests[pair]  # reset, because its guess depends on earlier queries
        request.cached_gjk_guess, request.cached_support_func_guess = _GUESS
        return pin.computeDistance(self._geometry, self._data, pair)

    def _compute_near_distances(self, dynamics: Dynamics, ahead: float) -> np.ndarray:
        shapes, braking = self._shapes, (self.acceleration, ahead, self.margin + ROW_ERROR)
        count = kernels.near_pairs(shapes, dynamics.motion, dynamics.q, dynamics.v, *braking)
        self.computed, near = count, shapes.near[:count]
        if count:
            dynamics.place(self._geometry, self._data)
        for i in near.tolist():
            result = self._distance(i)
            self._distances[i] = shapes.least[i] = result.min_distance
            shapes.normals[i] = result.normal
            shapes.first[i], shapes.second[i] = result.getNearestPoint1(), result.getNearestPoint2()
        return near

    def _rows(self, dynamics: Dynamics, pairs: np.ndarray) -> tuple[Array, Array, Array]:
        rows, rates, drifts = np.empty((len(pairs), dynamics.model.nv)), np.empty(len(pairs)), np.empty(len(pairs))
        kernels.distance_rows(self._shapes, dynamics.motion, pairs, rows, rates, drifts)
        return rows, rates, drifts


def _levers(
    moves: np.ndarray, links: np.ndarray, reach: Array, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Array, np.ndarray]:
    """Return `starts`, `components`, `levers` and `ends` of `ShapePairs`.

    A joint that moves one link of a pair changes their distance at most by its speed times its largest distance from
    the shape, `reach` (s, nv). These joints are from the link towards the root, up to the first joint that moves both
    links: a partial sum for all pairs.
    """
    starts, components, levers, ends = [0], [], [], np.zeros(pairs.shape, dtype=np.int64)
    for shape, link in enumerate(links):
        own = np.flatnonzero(moves[link])[::-1]  # numbered from the root
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
    """Return the index in q of each component of v, (nv,); -1 for joints with several degrees of freedom."""
    places = np.full(model.nv, -1, dtype=np.int64)
    for joint in model.joints:
        if joint.nq == joint.nv == 1:
            places[joint.idx_v] = joint.idx_q
    return places


def _reach(model: pin.Model, shape: pin.GeometryObject, radius: float) -> Array:
    """Return the largest distance of a shape from each joint that moves it, (nv,); 1 for prismatic joints."""
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
