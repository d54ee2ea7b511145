"""Which pairs may need a row, and which have one: held against the same equations in NumPy."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.limits import make_self_collision
from wbc_controller.inverse_dynamics.limits.self_collision import _reach
from wbc_controller.inverse_dynamics.limits.self_collision_kernels import near_pairs
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, moved_by
from wbc_controller.settings import SelfCollisionSettings

A, T, MARGIN = 10.0, 0.02, 0.03
FASTER = 0.2


# Which pairs may need a row. ----------------------------------------------------------------------------------------


class Plain:
    """A limit's first step: its lower bounds of the distances, and the distances below which pairs may need a row."""

    def __init__(self, model, limit):
        self.model, shapes = model.pinocchio, list(limit._geometry.geometryObjects)
        self.first, self.second = limit._pairs.T
        self.links = np.array([shape.parentJoint for shape in shapes])
        self.mounts = np.array([shape.placement.translation for shape in shapes])
        for shape in shapes:
            shape.geometry.computeLocalAABB()
        around = [(shape.geometry.aabb_center, shape.geometry.aabb_radius) for shape in shapes]
        self.radii = np.array([np.linalg.norm(centre) + radius for centre, radius in around])
        moves = moved_by(self.model)[self.links]
        signs = moves[self.second] - moves[self.first]
        reach = np.array([_reach(self.model, *shape) for shape in zip(shapes, self.radii, strict=True)])
        #: Largest rate of change of each pair's distance per unit speed of each joint, (pairs, nv).
        self.leverage = np.where(signs > 0, reach[self.second], reach[self.first]) * np.abs(signs)
        self.hinged = [(j.idx_v, j.idx_q) for j in self.model.joints if j.nq == j.nv == 1]
        self.least, self.seen = np.full(len(self.first), -np.inf), None

    def near(self, dynamics):
        """Pairs that may need a row, in order, and their reach; the bounds go down to those of the balls."""
        q, v = dynamics.q, dynamics.v
        turned = np.zeros(self.model.nv)
        for place, where in self.hinged:
            turned[place] = 0.0 if self.seen is None else abs(q[where] - self.seen[where])
        self.least, self.seen = self.least - self.leverage @ turned, np.array(q)
        reach = self.reach(self.leverage @ np.abs(v))
        near = np.flatnonzero(~(self.least > reach))
        for i in near:
            ball, closing = self.balls(dynamics, self.first[i], self.second[i])
            self.least[i] = np.maximum(np.nan_to_num(self.least[i], nan=-np.inf), ball)
            reach[i] = np.minimum(reach[i], self.reach(closing))
        near = near[~(self.least[near] > reach[near])]
        return near, reach[near]

    def reach(self, closing):
        after = closing + FASTER
        return after**2 / (2.0 * A) + after * T + closing * T + MARGIN

    def balls(self, dynamics, a, b):
        origins, twists = [], []
        for shape in (a, b):
            joint = dynamics.joints[self.links[shape]]
            origins.append(joint[:9].reshape(3, 3).T @ self.mounts[shape] + joint[9:])
            twists.append(dynamics.links[self.links[shape], :6])
        twist, apart = twists[1] - twists[0], origins[1] - origins[0]
        length, radii = np.linalg.norm(apart), self.radii[a] + self.radii[b]
        smaller = 0 if self.radii[a] < self.radii[b] else 1
        velocity = twist[:3] + np.cross(twist[3:], origins[smaller])
        # Of all unit normals in the cone about the line of the centres the one along which the velocity is largest.
        line = apart / length
        radial, across = -velocity @ line, np.linalg.norm(velocity - (velocity @ line) * line)
        half = np.arcsin(min(radii / length, 1.0)) if length > radii else np.pi
        angle = min(half, np.arctan2(across, radial))
        closing = max(0.0, radial * np.cos(angle) + across * np.sin(angle))
        return length - radii, closing + np.linalg.norm(twist[3:]) * self.radii[[a, b][smaller]]


@pytest.fixture(scope="module")
def robots(robot_of):
    found = {}
    for robot in ("g1", "talos"):
        of_robot, model = robot_of(robot)
        limits = of_robot.limits.model_copy(update={"self_collision": SelfCollisionSettings(enabled=True)})
        found[robot] = model, of_robot.model_copy(update={"limits": limits})
    return found


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_the_pairs_that_may_need_a_row_are_those_that_numpy_finds(robots, robot):
    """And hardly any beside them."""
    model, of_robot = robots[robot]
    limit = make_self_collision(of_robot, model)
    plain, dynamics, rng = Plain(model, limit), Dynamics(model), np.random.default_rng(0)
    table, q, v = limit._bind(dynamics), model.configuration(model.posture), np.zeros(model.nv)
    found, more = 0, 0
    for i in range(60):
        if i % 10 == 0:
            v = rng.choice([0.05, 1.0, 4.0]) * rng.uniform(-1.0, 1.0, model.nv) * (rng.random(model.nv) < 0.5)
        q = pin.integrate(model.pinocchio, q, 0.004 * v)
        dynamics.update(q, v)
        count = near_pairs(table, q, v, A, T, MARGIN)
        near, reach = limit._near[:count], limit._reach[:count]
        wanted, to = plain.near(dynamics)
        # The kernel's cone is wider: `max(radial, radial cos) + across sin` is at least the largest speed in it.
        assert set(wanted) <= set(near)
        assert np.all(np.diff(near) > 0)
        assert (reach[np.isin(near, wanted)] >= to - 1.0e-12).all()
        np.testing.assert_allclose(limit._least, plain.least, rtol=1.0e-12, atol=1.0e-12)
        known = rng.choice(near, count // 2, replace=False) if count else near
        limit._least[known] = plain.least[known] = 0.3 * rng.random(len(known))
        found += len(wanted)
        more += len(near) - len(wanted)
    assert found > 300
    assert more < 0.1 * found


@pytest.mark.parametrize("where", ["position", "velocity"])
def test_after_a_state_that_is_not_finite_all_bounds_are_found_again(robots, where):
    model, of_robot = robots["g1"]
    limit, dynamics = make_self_collision(of_robot, model), Dynamics(model)
    table = limit._bind(dynamics)
    good = model.configuration(model.posture), np.zeros(model.nv)
    q, v = map(np.array, good)
    (q if where == "position" else v)[-1] = np.nan
    touched = table.ends.max(axis=1) > 0
    before = near_pairs(table, *good, A, T, MARGIN)
    dynamics.update(q, v)
    assert near_pairs(table, q, v, A, T, MARGIN) > before
    dynamics.update(*good)
    for _ in range(2):
        assert near_pairs(table, *good, A, T, MARGIN) == before
    assert np.isfinite(limit._least[touched]).all()


# Which of them have one. --------------------------------------------------------------------------------------------


def plain_rows(limit, dynamics, pairs):
    """J_d, ḋ and δ of pairs, as `SelfCollisionLimit` says it."""
    table, found = limit._table, []
    twists, links, moves = dynamics.joint_jacobians.T, dynamics.links, dynamics.moves
    for pair in pairs:
        (one, other), normal = table.pairs[pair], table.normals[pair]
        a, b = table.shape_links[[one, other]]
        along = np.concatenate([normal, np.cross(table.first[pair], normal)])
        J = (moves[b] - moves[a]) * (twists @ along)
        drift = along @ (links[b, 6:] - links[a, 6:])
        for link, shape, p, sign in ((a, one, table.first[pair], -1.0), (b, other, table.second[pair], 1.0)):
            v, w, centre = links[link, :3], links[link, 3:6], limit._data.oMg[int(shape)].translation
            drift += sign * normal @ np.cross(w, v + np.cross(w, centre))
            about = sign * normal @ np.cross(w, np.cross(w, p - centre))
            drift += about if not about > 0.0 else 0.0
        found.append((J, along @ (links[b, :6] - links[a, :6]), drift))
    return [np.array(each) for each in zip(*found, strict=True)]


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_the_rows_of_distances_are_those_of_numpy(robots, robot):
    model, of_robot = robots[robot]
    limit, dynamics, rng = make_self_collision(of_robot, model), Dynamics(model), np.random.default_rng(1)
    for _ in range(5):
        q = model.configuration(model.posture + 0.1 * rng.normal(size=model.nj), pin.SE3.Random())
        dynamics.update(q, 3.0 * rng.normal(size=model.nv))
        near = limit._find(dynamics, T)
        assert len(near) > 5
        for found, expected in zip(limit._rows(dynamics, near), plain_rows(limit, dynamics, near), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("rows", [0, 1, 3, 200])
@pytest.mark.parametrize("spoilt", [False, True])
def test_pairs_with_the_largest_required_acceleration_have_a_row(robots, rows, spoilt):
    """In the order of the pairs; what is not a number comes last."""
    model, of_robot = robots["g1"]
    limit, dynamics, rng = make_self_collision(of_robot, model), Dynamics(model), np.random.default_rng(2)
    dynamics.update(model.configuration(model.posture), 2.0 * rng.normal(size=model.nv))
    find = limit._find

    def found(*args):
        near = find(*args)
        if spoilt:
            limit._distances[near[0]] = np.nan
        return near

    limit._find = found
    block, lower, upper = rng.normal(size=(rows, model.nv + 3)), rng.normal(size=rows), rng.normal(size=rows)
    C, rest = block[:, : model.nv], block[:, model.nv :].copy()
    limit.fill(dynamics, T, C, lower, upper)
    names, near = limit.names, limit._near[: limit.computed]
    near = near[~(limit._distances[near] > limit._reach[: len(near)])]
    J, rate, drift = limit._rows(dynamics, near)
    ahead = max(T, limit.horizon)
    bound = limit.bound(limit._distances[near], rate, ahead)
    needed = ~(bound < -FASTER / ahead)
    asks = dict(zip(near[needed].tolist(), (bound - drift)[needed].tolist(), strict=True))
    ranked = sorted(asks, key=lambda pair: (np.isnan(asks[pair]), -asks[pair]))[:rows]
    expected = sorted(ranked)
    assert [limit._pair_names[pair] for pair in expected] == list(names[: len(expected)])
    assert set(names[len(expected) :]) <= {"self_collision:unused"}
    np.testing.assert_array_equal(lower[: len(expected)], [asks[pair] for pair in expected])
    np.testing.assert_array_equal(C[: len(expected)], J[np.isin(near, expected)])
    assert (lower[len(expected) :] == -np.inf).all()
    assert not C[len(expected) :].any()
    assert (upper == np.inf).all()
    np.testing.assert_array_equal(block[:, model.nv :], rest)
    if not spoilt:
        limit.fill(dynamics, T, C, lower, upper)
        assert limit.names is names  # the same pairs, the same names
