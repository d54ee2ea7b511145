"""Limit that keeps the robot's links at a distance from each other."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.core.limits.limit import RowLimit
from wbc_controller.core.robot.dynamics import Dynamics, moved_by, placement_table
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.kernels.self_collision import acceleration_apart, approach, distance_rows, reach_of
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
#: Number of pairs above which a tighter bound of the closing speeds is computed first, as it saves distance queries.
_MANY = 12
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

    The pairs that could reach the margin are found in two steps. First, a lower bound of the distance of every pair:
    the last computed distance, less the rotation since then of each joint between the two links times the largest
    distance of the links' geometry from that joint. Then the distance itself, but only where a pair could not brake
    from its largest possible closing speed within the lower bound. The rows are the same as if all distances had been
    computed. If there are more pairs than rows, the pairs with the largest required d̈ get a row.

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
        """Make a limit.

        Args:
            model: the robot's model.
            geometry: convex shapes on the model's links, and the pairs of shapes to be kept apart.
            margin: least distance, m.
            acceleration: A, m/s².
            horizon: T, s.
            max_pairs: number of rows.
            summary: description of the pairs that are kept apart.
        """
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
        shapes, pairs = list(geometry.geometryObjects), list(geometry.collisionPairs)
        self._first = np.array([pair.first for pair in pairs], dtype=np.intp)
        self._second = np.array([pair.second for pair in pairs], dtype=np.intp)
        self._pair_names = tuple(
            f"self_collision:{shapes[pair.first].name}/{shapes[pair.second].name}" for pair in pairs
        )
        self._radii = np.array([_radius(shape.geometry) for shape in shapes])
        self._smaller = np.where(self._radii[self._first] < self._radii[self._second], self._first, self._second)
        self._links = np.array([shape.parentJoint for shape in shapes], dtype=np.intp)
        # For each pair the components of v that move one shape alone: -1 the first, 1 the second.
        moves = moved_by(model.pinocchio)[self._links]
        signs = moves[self._second] - moves[self._first]
        reach = np.array([_reach(model.pinocchio, *shape) for shape in zip(shapes, self._radii, strict=True)])
        # Largest rate of change of each pair's distance per unit speed of each joint between its links, (nv, pairs).
        leverage = np.where(signs > 0, reach[self._second], reach[self._first]) * np.abs(signs)
        self._leverage = np.ascontiguousarray(leverage.T)
        # In the memory that Pinocchio overwrites.
        self._shapes = placement_table(self._data.oMg)
        self._places = _places(model.pinocchio)
        self.computed = 0
        self._seen: Array | None = None
        self._least = np.full(len(pairs), -np.inf)

    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write the rows and bounds for one state."""
        rows[:] = 0.0
        lower[:] = -np.inf
        upper[:] = np.inf
        names: list[str] = []
        ahead = max(period, self.horizon)
        near, distance, points = self._near(dynamics, ahead)
        if near:
            pairs = np.array(near)
            J, rate, drift = self._rows(dynamics, pairs, points)
            bound = self.bound(distance, rate, ahead)
            there = (~(bound < -_FASTER / ahead)).nonzero()[0]
            if len(there):
                bound = bound[there] - drift[there]
                if len(there) > len(lower):
                    # In the order of the pairs: while the set of pairs stays the same each pair keeps its row, and the
                    # solver its warm start.
                    most = np.sort(np.argsort(-bound, kind="stable")[: len(lower)])
                    there, bound = there[most], bound[most]
                rows[: len(there)] = J[there]
                lower[: len(there)] = bound
                names = [self._pair_names[i] for i in pairs[there].tolist()]
        self.names = (*names, *(_UNUSED,) * (len(lower) - len(names)))

    def bound(self, distance: Array, rate: Array, ahead: float) -> Array:
        """Lower bound of d̈, (k,) in m/s², for pairs with given distances, (k,) in m, and rates ḋ, (k,) in m/s."""
        found = np.empty(len(distance))
        acceleration_apart(
            distance, rate, self.margin + INEXACT, self.acceleration, ahead, RETURN_SPEED, _RESERVE * self.acceleration,
            found,
        )  # fmt: skip
        return found

    def _rows(
        self, dynamics: Dynamics, pairs: np.ndarray, points: tuple[Array, Array, Array]
    ) -> tuple[Array, Array, Array]:
        """J_d (k, nv), ḋ (k,) and δ (k,) of given pairs, from their normals and nearest points, (k, 3) each."""
        J, rate, drift = np.empty((len(pairs), dynamics.model.nv)), np.empty(len(pairs)), np.empty(len(pairs))
        distance_rows(
            *points, self._first[pairs], self._second[pairs], self._links, self._shapes,
            dynamics.joint_jacobians, dynamics.moves, dynamics.links, J, rate, drift,
        )  # fmt: skip
        return J, rate, drift

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

    def _near(self, dynamics: Dynamics, ahead: float) -> tuple[list[int], Array, tuple[Array, Array, Array]]:
        """Find the pairs that may need a row: indices, distances (k,), and normals and nearest points, each (k, 3)."""
        q, reach = dynamics.q, np.empty(len(self._least))
        seen = q if self._seen is None else self._seen
        approach(q, seen, self._places, dynamics.v, self._leverage, *self._stopping(ahead), self._least, reach)
        self._seen = np.array(q)
        near = (~(self._least > reach)).nonzero()[0]
        dynamics.place(self._geometry, self._data)
        if len(near) > _MANY:
            near, tighter = self._nearer(dynamics, near, ahead)
            reach[near] = tighter
        found: list[int] = []
        normal, first, second = np.empty((3, len(near), 3))
        for i in near.tolist():
            answer = self._distance(i)
            self._least[i] = distance = answer.min_distance
            if not (distance > reach[i]):
                k = len(found)
                normal[k], first[k], second[k] = answer.normal, answer.getNearestPoint1(), answer.getNearestPoint2()
                found.append(i)
        self.computed = len(near)
        k = len(found)
        return found, self._least[found], (normal[:k], first[:k], second[:k])

    def _stopping(self, ahead: float) -> tuple[float, float, float, float]:
        """Deceleration, horizon, growth of the closing speed and margin, as `kernels.self_collision` takes them."""
        return self.acceleration, ahead, _FASTER, self.margin + INEXACT

    def _nearer(self, dynamics: Dynamics, pairs: np.ndarray, ahead: float) -> tuple[np.ndarray, Array]:
        """Narrow down the pairs that may need a row by the twists of the links; also gives their reach.

        Lower bounds of the distances are those of the balls that enclose the shapes.
        """
        origins, twist = self._shapes[:, 9:], dynamics.links[self._links, :6]
        first, second = self._first[pairs], self._second[pairs]
        relative = twist[second] - twist[first]
        turning = np.sqrt(_dot(relative[:, 3:], relative[:, 3:]))
        apart = origins[second] - origins[first]
        length, radii = np.sqrt(_dot(apart, apart)), self._radii[first] + self._radii[second]
        # The normal lies in the cone about the line between the balls' centres that contains both balls.
        sine = np.minimum(radii / length, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
        # The relative twist has the same velocity along the normal at both nearest points: take the smaller ball's.
        smaller = self._smaller[pairs]
        v = relative[:, :3] + _cross(relative[:, 3:], origins[smaller])
        speed, radial = _dot(v, v), _dot(v, apart) / -length
        across = np.sqrt(np.maximum(speed - radial**2, 0.0))
        closing = np.where(sine < 1.0, np.maximum(radial, radial * cosine) + across * sine, np.sqrt(speed))
        closing = np.maximum(closing, 0.0) + turning * self._radii[smaller]
        self._least[pairs] = least = np.maximum(self._least[pairs], length - radii)
        reach = np.empty(len(closing))
        reach_of(closing, *self._stopping(ahead), reach)
        there = ~(least > reach)
        return pairs[there], reach[there]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ki,ki->k", a, b))


def _cross(a: Array, b: Array) -> Array:
    """Cross products of rows, (k, 3); much faster than `numpy.cross` on few rows."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return result


def _places(model: pin.Model) -> np.ndarray:
    """Where the position of each joint with one degree of freedom stands in q, by component of v; else -1; (nv,)."""
    places = np.full(model.nv, -1, dtype=np.intp)
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
