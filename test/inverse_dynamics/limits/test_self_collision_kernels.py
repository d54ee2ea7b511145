"""Which pairs may need a row, and which have one: held against the same equations in NumPy."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.compiled import Bound
from wbc_controller.controller.build.limits import make_self_collision
from wbc_controller.inverse_dynamics.limits.self_collision import _reach
from wbc_controller.inverse_dynamics.limits.self_collision_kernels import (
    DISTANCE,
    FIRST,
    NORMAL,
    RESULT,
    SECOND,
    fill_apart,
    near_pairs,
)
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, moved_by
from wbc_controller.settings import SelfCollisionSettings

A, T, MARGIN = 10.0, 0.02, 0.03
FASTER, RETURN_SPEED, RESERVE = 0.2, 0.1, 3.0


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
    limit._bind(dynamics)
    table, q, v = limit._bound.table, model.configuration(model.posture), np.zeros(model.nv)
    found, more = 0, 0
    for i in range(60):
        if i % 10 == 0:
            v = rng.choice([0.05, 1.0, 4.0]) * rng.uniform(-1.0, 1.0, model.nv) * (rng.random(model.nv) < 0.5)
        q = pin.integrate(model.pinocchio, q, 0.004 * v)
        dynamics.update(q, v)
        count = near_pairs(table, q, v, A, T, MARGIN)
        near, reach = limit._near[:count], limit._memory[4][:count]
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
    limit._bind(dynamics)
    good = model.configuration(model.posture), np.zeros(model.nv)
    q, v = map(np.array, good)
    (q if where == "position" else v)[-1] = np.nan
    touched = limit._ends.max(axis=1) > 0
    before = near_pairs(limit._bound.table, *good, A, T, MARGIN)
    dynamics.update(q, v)
    assert near_pairs(limit._bound.table, q, v, A, T, MARGIN) > before
    dynamics.update(*good)
    for _ in range(2):
        assert near_pairs(limit._bound.table, *good, A, T, MARGIN) == before
    assert np.isfinite(limit._least[touched]).all()


# Which of them have one. --------------------------------------------------------------------------------------------


def plain_rows(results, pairs, shapes, links, shape_links, twists, moves):
    """J_d, ḋ and δ of pairs, as `SelfCollisionLimit` says it."""
    found = []
    for result, (one, other) in zip(results, pairs, strict=True):
        normal, a, b = result[NORMAL : NORMAL + 3], shape_links[one], shape_links[other]
        along = np.concatenate([normal, np.cross(result[FIRST : FIRST + 3], normal)])
        J = (moves[b] - moves[a]) * (twists @ along)
        drift = along @ (links[b, 6:] - links[a, 6:])
        for link, shape, at, sign in ((a, one, FIRST, -1.0), (b, other, SECOND, 1.0)):
            v, w, centre, p = links[link, :3], links[link, 3:6], shapes[shape, 9:], result[at : at + 3]
            drift += sign * normal @ np.cross(w, v + np.cross(w, centre))
            about = sign * normal @ np.cross(w, np.cross(w, p - centre))
            drift += about if not about > 0.0 else 0.0
        found.append((J, along @ (links[b, :6] - links[a, :6]), drift))
    return (np.array(each) for each in zip(*found, strict=True))


def plain_bound(distance, rate):
    room, reach = distance - MARGIN + T * rate, A * T
    fastest = np.where(
        room > 0.0, np.sqrt(reach**2 + 2.0 * A * np.maximum(room, 0.0)) - reach, np.maximum(room / T, -RETURN_SPEED)
    )
    return np.minimum((-rate - np.where(np.isnan(room), np.nan, fastest)) / T, RESERVE * A)


@settings(deadline=None, max_examples=400)
@given(
    seed=st.integers(0, 2**32 - 1),
    k=st.integers(1, 16),
    rows=st.sampled_from([0, 1, 2, 3, 4, 5, 20]),
    beside=st.sampled_from(["", "equal", "nan", "far"]),
)
def test_rows_and_bounds_are_what_numpy_makes_of_the_same_equations(seed, k, rows, beside):
    rng, shapes, links, nv = np.random.default_rng(seed), 4, 5, 7
    pairs = rng.integers(0, shapes, (k, 2))
    shape_links, moves = rng.integers(0, links, shapes), rng.integers(0, 2, (links, nv)).astype(np.int8)
    motion, twists, placements = rng.normal(size=(links, 12)), rng.normal(size=(nv, 6)), rng.normal(size=(shapes, 12))
    results = rng.normal(size=(k, RESULT))
    results[:, NORMAL : NORMAL + 3] /= np.linalg.norm(results[:, NORMAL : NORMAL + 3], axis=1)[:, None]
    results[:, DISTANCE] = rng.uniform(-0.02, 0.1, k)
    if beside == "equal":
        same = rng.random(k) < 0.6
        results[same], pairs[same] = results[0], pairs[0]
    if beside == "nan":
        results[rng.random(k) < 0.3, DISTANCE] = np.nan
    near = np.flatnonzero(rng.random(k) < 0.9)
    reach = np.where(rng.random(k) < 0.3, -1.0, 1.0) if beside == "far" else np.ones(k)
    ints = np.zeros(k, dtype=np.int64)
    padded, least, shown = np.concatenate([near, ints])[:k], np.full(k, -9.0), np.full(k, -1)
    before = shown.copy()
    nothing = np.zeros(1)
    table = Bound(
        k, shapes, links, nv, 1, 1, pairs, ints, ints, ints, nothing, ints, shape_links, nothing,
        np.array([FASTER, RETURN_SPEED, RESERVE]), nothing, motion, twists, moves, placements, results, nothing, least,
        nothing, padded, reach, ints.copy(), np.zeros((k, nv)), np.zeros(k), np.zeros(k), ints.copy(), shown,
    )  # fmt: skip
    block, bounds = rng.normal(size=(rows, nv + 3)), rng.normal(size=(2, rows))
    C, rest = block[:, :nv], block[:, nv:].copy()
    changed = fill_apart(table.table, len(near), A, T, MARGIN, C, *bounds)

    np.testing.assert_array_equal(least, np.where(np.isin(range(k), near), results[:, DISTANCE], -9.0))
    wanted = (np.zeros((rows, nv)), np.full(rows, -np.inf), np.full(k, -1))
    found = near[~(results[near, DISTANCE] > reach[: len(near)])]
    if len(found):
        J, rate, drift = plain_rows(results[found], pairs[found], placements, motion, shape_links, twists, moves)
        bound = plain_bound(results[found, DISTANCE], rate)
        there = np.flatnonzero(~(bound < -FASTER / T))
        bound = bound[there] - drift[there]
        # Those that ask for most, of equal ones the first, and at last what is not a number.
        most = np.sort(np.argsort(-bound, kind="stable")[:rows])
        wanted[0][: len(most)], wanted[1][: len(most)] = J[there[most]], bound[most]
        wanted[2][: len(most)] = found[there[most]]
    np.testing.assert_allclose(C, wanted[0], rtol=1.0e-9, atol=1.0e-11)
    np.testing.assert_allclose(bounds[0], wanted[1], rtol=1.0e-9, atol=1.0e-8)
    assert (bounds[1] == np.inf).all()
    np.testing.assert_array_equal(shown, wanted[2])
    assert changed == (shown != before).any()
    assert not fill_apart(table.table, len(near), A, T, MARGIN, C, *bounds)  # the second time
    np.testing.assert_array_equal(block[:, nv:], rest)
