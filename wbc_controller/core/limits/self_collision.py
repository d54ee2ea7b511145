"""Bounds that keep the robot's links at a distance from each other."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.core.limits.limit import RowLimit
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.records import Array

#: Speed at which links part that are nearer than the margin, m/s: gentle, as they may start there.
RETURN_SPEED = 0.1
#: Room that is kept above the margin for what the rows leave out, m: the worst that was seen is 1.2 mm.
INEXACT = 0.002
#: How many times the deceleration counted on may be asked for where it was not enough.
_RESERVE = 3.0
#: How much faster than now a pair may close after a cycle in which it had no row, m/s: a row that bounds d̈ at less than
#: minus this by T is left out.
_FASTER = 0.2
#: Number of pairs from which it pays to look at their closing speeds more closely before their distances are computed.
_MANY = 12
#: Tolerance of the distances, m, and where their iteration starts: a direction, and two vertices.
_GJK_TOLERANCE = 1.0e-10
_GUESS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
#: The name of rows that no pair needs.
_UNUSED = "self_collision:unused"


class SelfCollisionLimit(RowLimit):
    """Rows J_d v̇ ≥ lower for the pairs of links that could otherwise come nearer than the margin.

    With d the distance of two convex shapes, n the unit vector from the one's nearest point p₁ to the other's p₂,

        ḋ = nᵀ (v₂(p₂) - v₁(p₁)) = J_d v,    d̈ ≥ J_d v̇ + δ.

    v₁, v₂ are the velocities of the links at these points. δ is nᵀ (a₂ - a₁) at v̇ = 0, where of the centripetal
    acceleration about the shape's own origin only what brings the links nearer counts: the nearest points slide on the
    shapes, which makes the rest smaller, for balls zero. The tangential velocity's share, which only parts them, is
    left out.

    The closing speed w = -ḋ at a period's end is bounded so that the links can stop before the margin: with A the
    deceleration, T the horizon and r = d - margin - 2 mm - w T the room that is left after T,

        w² / (2 A) + w T ≤ r,    so    d̈ ≥ (w - √(A² T² + 2 A r) + A T) / T.

    It is the law of `JointMotionLimit`, twice as careful with the last period, so that near the margin r decays as a
    critically damped spring with the time constant T: what δ has wrong, e, costs a distance of e T². Where r < 0 the
    links have to part with the speed -r / T, at most `RETURN_SPEED`. No row asks for more than `_RESERVE` A.

    Which pairs could reach the margin is found in two steps. A lower bound of every pair's distance is what it was when
    it was last computed, less what the joints between the two links have turned since, times the farthest that anything
    of theirs can be from each joint. Only where the pair could not brake from its largest possible closing speed within
    that is the distance computed anew: the rows are the same as if all had been. Of more pairs than rows those that ask
    for most get one.

    Attributes:
        margin: least distance, m.
        acceleration: A, m/s².
        horizon: T, at least the period, s.
        computed: number of distances that the last cycle computed.
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
            geometry: convex shapes on the model's links, and the pairs of them to be kept apart.
            margin: least distance, m.
            acceleration: A, m/s².
            horizon: T, s.
            max_pairs: number of rows.
            summary: which pairs are kept apart, for a person.
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
        # Of each shape, whether a column of v moves it; and of each pair, how (-1: the first one, 1: the second one).
        self._moves = np.array([_moved(model.pinocchio, shape.parentJoint) for shape in shapes])
        self._signs = self._moves[self._second] - self._moves[self._first]
        reach = np.array([_reach(model.pinocchio, *shape) for shape in zip(shapes, self._radii, strict=True)])
        # Largest rate of each pair's distance per speed of each joint between its links, (pairs, nv).
        self._leverage = np.where(self._signs > 0.0, reach[self._second], reach[self._first]) * np.abs(self._signs)
        # Views of the placements that Pinocchio overwrites.
        self._origins = [self._data.oMg[i].translation for i in range(len(shapes))]
        self._joints = _joint_columns(model.pinocchio)
        self.computed = 0
        self._seen: Array | None = None
        self._least = np.full(len(pairs), -np.inf)

    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write the rows at one state."""
        rows[:] = 0.0
        lower[:] = -np.inf
        upper[:] = np.inf
        names = [_UNUSED] * len(lower)
        ahead = max(period, self.horizon)
        near, distance, points = self._near(dynamics, ahead)
        if near:
            pairs = np.array(near)
            normal, first, second = points
            along = np.hstack([normal, _cross(first, normal)])  # of a twist at the world's origin to nᵀ v(p)
            J = (along @ dynamics.joint_jacobians) * self._signs[pairs]
            bound = self.bound(distance, J @ dynamics.v, ahead)
            there = (~(bound < -_FASTER / ahead)).nonzero()[0]
            if len(there):
                bound = bound[there] - self._drift(dynamics, pairs[there], along[there], first[there], second[there])
                # In the order of the pairs: a pair keeps its row, and the solver its guess, while none comes or goes.
                most = np.sort(np.argsort(-bound, kind="stable")[: len(lower)])
                rows[: len(most)] = J[there[most]]
                lower[: len(most)] = bound[most]
                names[: len(most)] = [self._pair_names[pairs[i]] for i in there[most].tolist()]
        self.names = tuple(names)

    def bound(self, distance: Array, rate: Array, ahead: float) -> Array:
        """Least d̈ of pairs at these distances, (k,) in m, with these rates, (k,) in m/s; gives (k,) in m/s²."""
        A, T = self.acceleration, ahead
        room = distance - self.margin - INEXACT + T * rate
        fastest = np.sqrt((A * T) ** 2 + 2.0 * A * np.maximum(room, 0.0)) - A * T
        fastest += np.maximum(np.minimum(room, 0.0) / T, -RETURN_SPEED)
        return np.asarray(np.minimum((-rate - fastest) / T, _RESERVE * A))

    def distances(self, dynamics: Dynamics) -> dict[str, float]:
        """Distance of every pair at one state, m, by the name of its row."""
        dynamics.place(self._geometry, self._data)
        return {name: float(self._distance(i).min_distance) for i, name in enumerate(self._pair_names)}

    def _distance(self, pair: int) -> coal.DistanceResult:
        """Distance of a pair where the shapes are now."""
        # Always from the same guess: what was computed before must not show, not even in the last digit.
        request = self._requests[pair]
        request.cached_gjk_guess, request.cached_support_func_guess = _GUESS
        return pin.computeDistance(self._geometry, self._data, pair)

    def _near(self, dynamics: Dynamics, ahead: float) -> tuple[list[int], Array, tuple[Array, Array, Array]]:
        """Pairs that may need a row: indices, distances (k,), and normals and nearest points, each (k, 3)."""
        q_index, v_index = self._joints
        q, turned = dynamics.q[q_index], np.zeros((2, dynamics.model.nv))
        if self._seen is not None:
            turned[0, v_index] = q - self._seen
        self._seen = q
        turned[1] = dynamics.v
        lost, closing = np.abs(turned) @ self._leverage.T
        self._least -= lost
        reach = self._reach_of(closing, ahead)
        near = (~(self._least > reach)).nonzero()[0]
        dynamics.place(self._geometry, self._data)
        if len(near) > _MANY:
            near, tighter = self._nearer(dynamics, near, ahead)
            reach[near] = tighter
        found, answers = [], []
        for i in near.tolist():
            answer = self._distance(i)
            self._least[i] = distance = answer.min_distance
            if not (distance > reach[i]):
                found.append(i)
                answers.append((answer.normal, answer.getNearestPoint1(), answer.getNearestPoint2()))
        self.computed = len(near)
        points = np.array(answers).reshape(-1, 3, 3)
        return found, self._least[found], (points[:, 0], points[:, 1], points[:, 2])

    def _reach_of(self, closing: Array, ahead: float) -> Array:
        """Distance, m, below which a pair with at most this closing speed, (k,) in m/s, may need a row."""
        # w_f²/(2 A) + w_f T + w T + margin, with the w_f = w + `_FASTER` that a cycle without a row may lead to.
        half = 0.5 / self.acceleration
        least = _FASTER * (_FASTER * half + ahead) + self.margin + INEXACT
        return np.asarray((half * closing + (2.0 * half * _FASTER + 2.0 * ahead)) * closing + least)

    def _nearer(self, dynamics: Dynamics, pairs: np.ndarray, ahead: float) -> tuple[np.ndarray, Array]:
        """Those of some pairs that may need a row by the links' velocities too, and the distances below which they do.

        Their distances are no less than those of balls around the shapes.
        """
        origins = np.concatenate(self._origins).reshape(-1, 3)
        twist = self._moves @ (dynamics.joint_jacobians * dynamics.v).T
        first, second = self._first[pairs], self._second[pairs]
        relative = twist[second] - twist[first]
        turning = np.sqrt(_dot(relative[:, 3:], relative[:, 3:]))
        apart = origins[second] - origins[first]
        length, radii = np.sqrt(_dot(apart, apart)), self._radii[first] + self._radii[second]
        # The normal is within the cone around the line between the balls' centres that has both balls in it.
        sine = np.minimum(radii / length, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
        smaller = self._smaller[pairs]  # of the two nearest points, along the normal, both have the same velocity
        v = relative[:, :3] + _cross(relative[:, 3:], origins[smaller])
        speed, radial = _dot(v, v), _dot(v, apart) / -length
        across = np.sqrt(np.maximum(speed - radial**2, 0.0))
        closing = np.where(sine < 1.0, np.maximum(radial, radial * cosine) + across * sine, np.sqrt(speed))
        closing = np.maximum(closing, 0.0) + turning * self._radii[smaller]
        self._least[pairs] = least = np.maximum(self._least[pairs], length - radii)
        reach = self._reach_of(closing, ahead)
        there = ~(least > reach)
        return pairs[there], reach[there]

    def _drift(self, dynamics: Dynamics, pairs: np.ndarray, along: Array, first: Array, second: Array) -> Array:
        """δ of some pairs, (k,) in m/s², with their nearest points, both (k, 3)."""
        spatial = ((along @ dynamics.joint_jacobians_rate) * self._signs[pairs]) @ dynamics.v
        # Of the first shapes, then of the second, nᵀ (ω × v(p)): what an acceleration has besides the spatial one. Of
        # the part about the shape's origin c, nᵀ (ω × (ω × (p - c))), only what brings the links nearer.
        shapes = np.concatenate([self._first[pairs], self._second[pairs]])
        twist = self._moves[shapes] @ (dynamics.joint_jacobians * dynamics.v).T  # (2 k, 6), at the world's origin
        v, w = twist[:, :3], twist[:, 3:]
        c = np.concatenate(self._origins).reshape(-1, 3)[shapes]
        n, arm = np.concatenate([-along[:, :3], along[:, :3]]), np.concatenate([first, second]) - c
        nw, ww = _dot(n, w), _dot(w, w)
        carried = _dot(v, _cross(n, w)) + nw * _dot(w, c) - ww * _dot(n, c)
        about = nw * _dot(w, arm) - ww * _dot(n, arm)
        extra = carried + np.minimum(about, 0.0)
        return np.asarray(spatial + extra[: len(pairs)] + extra[len(pairs) :])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ki,ki->k", a, b))


def _cross(a: Array, b: Array) -> Array:
    """Cross products of rows, (k, 3); much faster than `numpy.cross` on few of them."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return result


def _moved(model: pin.Model, joint: int) -> Array:
    """Which columns of v move a link, as ones, (nv,)."""
    moved = np.zeros(model.nv)
    for carrier in model.supports[joint]:
        if carrier > 0:
            moved[model.joints[carrier].idx_v : model.joints[carrier].idx_v + model.joints[carrier].nv] = 1.0
    return moved


def _joint_columns(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Where the joints with one degree of freedom stand in q and in v. Only they change a distance."""
    single = [joint for joint in model.joints if joint.nq == joint.nv == 1]
    return np.array([j.idx_q for j in single], dtype=np.intp), np.array([j.idx_v for j in single], dtype=np.intp)


def _reach(model: pin.Model, shape: pin.GeometryObject, radius: float) -> Array:
    """Farthest that a shape can be from each joint that carries it, (nv,) in m; 1 for joints that slide."""
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
    """Radius of a ball around a shape's origin that encloses it, m."""
    geometry.computeLocalAABB()
    return float(np.linalg.norm(geometry.aabb_center)) + float(geometry.aabb_radius)
