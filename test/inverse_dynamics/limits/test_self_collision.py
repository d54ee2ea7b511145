"""Self-collision: rows by finite differences, the barrier against adversaries, and arms commanded through the torso."""

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from conflicts import conflict_of
from demands import demand
from robot_cases import joint, link, robot
from snapshots import rate_along
from urdf_models import build_model

from wbc_controller.controller.build.collision_model import build_collision_model
from wbc_controller.controller.build.limits import make_self_collision
from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, SelfCollisionLimit, TorqueLimit
from wbc_controller.inverse_dynamics.limits.self_collision import RETURN_SPEED, ROW_ERROR
from wbc_controller.inverse_dynamics.limits.self_collision_kernels import SPEED_INCREASE
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import PostureTask
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Reference, References, RobotState
from wbc_controller.settings.limits import SelfCollisionSettings
from wbc_controller.settings.resources import share_folder

SRDF = {"g1": "", "talos": "package://example-robot-data/robots/talos_data/srdf/talos.srdf"}
MARGIN = 0.02


def settings(robot, **changes):
    return {"self_collision": SelfCollisionSettings(enabled=True, srdf=SRDF[robot], margin=MARGIN, **changes)}


@pytest.fixture(scope="module")
def every_pair(robot_of):
    """Return G1's model, and a limit with a row for every pair."""
    of_robot, model = robot_of("g1")
    changed = of_robot.limits.model_copy(update=settings("g1"))
    return model, make_self_collision(of_robot.model_copy(update={"limits": changed}), model)


def random_motion(model, rng):
    joints = np.clip(model.posture + 0.3 * rng.normal(size=model.na), model.position_lower, model.position_upper)
    return model.configuration(joints, pin.SE3.Random()), rng.normal(size=model.nv)


def near_of(limit, dynamics, ahead):
    """Return the pairs with required distances."""
    near = limit._compute_near_distances(dynamics, ahead).copy()
    return near, limit._distances[near]


def rows_of(limit, dynamics, near):
    """Return J_d and the drift of pairs with computed distances."""
    J, rate, drift = limit._rows(dynamics, np.array(near))
    np.testing.assert_allclose(J @ dynamics.v, rate, rtol=1e-12, atol=1e-12)
    return J, drift


def another(model, limit):
    """Return an equal limit without history."""
    how = {"margin": limit.margin, "acceleration": limit.acceleration, "horizon": limit.horizon}
    return SelfCollisionLimit(model, limit._geometry, **how, max_pairs=len(limit.names))


def along(model, limit, q, v, step, pairs):
    """Return distances of pairs before, at and after a state at constant velocity, (3, k)."""
    dynamics, found = Dynamics(model), []
    for time in (-step, 0.0, step):
        dynamics.update(pin.integrate(model.pinocchio, q, time * v), v)
        distances = limit.distances(dynamics)
        found.append([distances[limit._pair_names[i]] for i in pairs])
    return np.array(found)


def test_rows_give_the_rates_of_distances(every_pair):
    model, limit = every_pair
    rng, dynamics, checked = np.random.default_rng(0), Dynamics(model), 0
    for _ in range(4):
        q, v = random_motion(model, rng)
        dynamics.update(q, v)
        near, distance = near_of(limit, dynamics, 0.2)
        rate = rows_of(limit, dynamics, near)[0] @ v
        before, now, after = along(model, limit, q, v, 1.0e-4, near)
        np.testing.assert_allclose(now, distance, atol=1e-9)
        apart = now > 0.002  # the normal of touching shapes changes within the step
        error = np.abs((after - before) / 2.0e-4 - rate)[apart]
        assert np.quantile(error, 0.9) < 2.0e-3
        assert error.max() < 0.05  # at an edge
        assert np.abs(rate).max() > 0.2
        checked += apart.sum()
    assert checked > 200


BALL = '<collision><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.05"/></geometry></collision>'
BASE = link("base", 5.0, inertia=1.0)


def ball_link(name, parent, at, axis, kind="revolute"):
    """Return a link with a sphere at its end, and its joint."""
    limit = 'lower="-3" upper="3" effort="100" velocity="10"'
    own = link(name, 1.0, inertia=0.1, more=BALL)
    return own + joint(f"{name}_joint", parent, name, axis, at, kind=kind, limit=limit)


@pytest.fixture(scope="module")
def balls():
    """Two arms of three joints each, one of them prismatic, with a sphere at each link's end."""
    arms = [
        ball_link(f"{side}0", "base", f"0 {y} 0", "1 0 0")
        + ball_link(f"{side}1", f"{side}0", "0 0 -0.3", "0 1 0")
        + ball_link(f"{side}2", f"{side}1", "0 0 -0.3", "0.6 0.8 0", "prismatic")
        for side, y in (("l", 0.2), ("r", -0.2))
    ]
    joints = [f"{side}{i}_joint" for side in "lr" for i in range(3)]
    model = build_model(robot(BASE, *arms), joints, [0.0] * 6)
    collision = build_collision_model(model, margin=MARGIN)
    return model, SelfCollisionLimit(
        model, collision.geometry, margin=MARGIN, acceleration=10.0, horizon=0.02, max_pairs=20
    )


def test_drift_of_spheres(balls):
    model, limit = balls
    rng, dynamics = np.random.default_rng(1), Dynamics(model)
    for _ in range(20):
        q, v = model.configuration(rng.uniform(-1.0, 1.0, model.na), pin.SE3.Random()), rng.normal(size=model.nv)
        dynamics.update(q, v)
        near, _ = near_of(limit, dynamics, 50.0)  # all pairs are near
        assert len(near) == len(limit._pair_names)
        J, drift = rows_of(limit, dynamics, near)
        step = 1.0e-3
        before, now, after = along(model, limit, q, v, step, near)
        second = (after - 2.0 * now + before) / step**2
        # Omitted: (|ċ|² - ḋ²) / |c| by the tangential velocity, with the vector c between the centres.
        first, last = limit._pairs[near].T

        def between_centres(dynamics, first=first, last=last):
            dynamics.place(limit._geometry, limit._data)
            centres = np.array([limit._data.oMg[i].translation for i in range(6)])
            return centres[last] - centres[first]

        c, c_dot = between_centres(dynamics), rate_along(between_centres, model, q, v, step)
        parts = (np.sum(c_dot**2, axis=1) - (J @ v) ** 2) / np.linalg.norm(c, axis=1)
        np.testing.assert_allclose(second, drift + parts, atol=2e-3 * (1.0 + np.abs(second).max()))
        assert (parts >= -1e-6).all()


def test_rows_do_not_depend_on_earlier_states(every_pair):
    model, limit = every_pair
    rng, dynamics = np.random.default_rng(4), Dynamics(model)
    k, used, skipped = 400, 0, 0
    filled = [(np.empty((k, model.nv)), np.empty(k), np.empty(k)) for _ in range(2)]
    q, v = model.configuration(model.posture), np.zeros(model.nv)
    for i in range(120):
        if i % 30 == 0:
            v = rng.uniform(-2.0, 2.0, model.nv) * (rng.random(model.nv) < 0.5)
        q = pin.integrate(model.pinocchio, q, 0.004 * v)
        dynamics.update(q, v)
        limit.fill(dynamics, 0.002, *filled[0])
        names = limit.names
        skipped += len(limit._pair_names) - limit.computed
        if i % 10 == 9:
            distances = limit.distances(dynamics)
            assert (limit._shapes.least <= [distances[name] + 1e-9 for name in limit._pair_names]).all()
            new = another(model, limit)
            new.fill(dynamics, 0.002, *filled[1])
            assert new.computed > 0
            assert new.names == names
            for ours, fresh in zip(filled[0], filled[1], strict=True):
                np.testing.assert_array_equal(ours, fresh)
            used += np.isfinite(filled[0][1]).sum()
    assert used > 5
    assert skipped > 0.8 * 120 * len(limit._pair_names)  # most distances were skipped


def test_no_pair_is_missed(every_pair):
    """At any speed, compared with the distances and rates of all pairs."""
    model, limit = every_pair
    rng, dynamics, found, all_pairs = np.random.default_rng(9), Dynamics(model), 0, list(range(len(limit._pair_names)))
    filled = np.empty((400, model.nv)), np.empty(400), np.empty(400)
    for _ in range(12):
        q, v = random_motion(model, rng)
        v *= rng.uniform(0.2, 4.0)
        dynamics.update(q, v)
        new = another(model, limit)
        new.fill(dynamics, 0.002, *filled)
        assert new.computed < 0.7 * len(all_pairs)
        distance = np.array(list(new.distances(dynamics).values()))
        bound = limit.bound(distance, rows_of(new, dynamics, all_pairs)[0] @ v, limit.horizon)
        needed = {limit._pair_names[i] for i in np.flatnonzero(bound >= -SPEED_INCREASE / limit.horizon)}
        assert set(new.names) - {"self_collision:unused"} == needed
        found += len(needed)
    assert found > 50


def barrier(acceleration=10.0, horizon=0.02):
    """Return a barrier at `MARGIN` plus the row error."""
    limit = SelfCollisionLimit.__new__(SelfCollisionLimit)
    limit.acceleration, limit.horizon, limit.margin = acceleration, horizon, MARGIN - ROW_ERROR
    return limit


@pytest.mark.parametrize(
    ("period", "horizon", "acceleration"),
    [(0.001, 0.02, 3.0), (0.002, 0.0, 40.0), (0.005, 0.02, 40.0), (0.005, 0.0, 3.0)],
)
def test_viable_distances_keep_the_margin(period, horizon, acceleration):
    limit, rng = barrier(acceleration, horizon), np.random.default_rng(5)
    T = max(period, horizon)
    room = rng.uniform(0.0, 0.5, 2000)
    fastest = np.sqrt((acceleration * T) ** 2 + 2.0 * acceleration * room) - acceleration * T
    d, rate = MARGIN + room, -fastest * rng.random(2000)
    for i in range(int(1.5 / period)):
        bound = limit.bound(d, rate, T)
        assert (bound <= 1.5 * acceleration).all()  # little more than A is required
        a = np.maximum(bound, -30.0 if i % 50 < 40 else 5.0)  # closes with full demand, and separates at times
        d, rate = d + period * rate + 0.5 * period**2 * a, rate + period * a
        assert d.min() >= MARGIN - 1.0e-6
    assert np.median(d) < MARGIN + 0.01  # the barrier was active


def test_links_nearer_than_the_margin_separate_slowly():
    limit = barrier()
    d, rate, fastest, hardest = np.array([-0.05, 0.0, 0.015]), np.zeros(3), 0.0, 0.0
    for _ in range(1500):
        a = limit.bound(d, rate, 0.02)
        d, rate = d + 0.002 * rate + 0.5 * 0.002**2 * a, rate + 0.002 * a
        fastest, hardest = max(fastest, rate.max()), max(hardest, np.abs(a).max())
    assert (d > MARGIN - 1.0e-4).all()
    assert fastest <= RETURN_SPEED * (1.0 + 1e-9)
    assert hardest <= RETURN_SPEED / 0.02 * (1.0 + 1e-9)
    assert np.isnan(barrier().bound(np.array([np.nan, 0.1]), np.array([0.0, np.nan]), 0.02)).all()


def distance_of_hulls(model, names):
    """Return a function of q: the smallest distance of pairs of links by the hulls of the original meshes, m."""
    robot = pin.buildModelFromXML(model.urdf, pin.JointModelFreeFlyer())
    folder = str(share_folder("example-robot-data").parent)
    geometry, parts = pin.buildGeomFromUrdfString(robot, model.urdf, pin.COLLISION, None, [folder]), {}
    for i, part in enumerate(geometry.geometryObjects):
        if isinstance(part.geometry, coal.BVHModelBase):
            part.geometry.buildConvexHull(True, "Qt")
            part.geometry = part.geometry.convex
        parts.setdefault(robot.frames[part.parentFrame].name, []).append(i)
    for name in names:
        ends = name.partition(":")[2].split("/")
        for pair in itertools.product(*(parts[end] for end in ends)):
            geometry.addCollisionPair(pin.CollisionPair(*pair))
    data, distances = robot.createData(), geometry.createData()
    joints = [robot.joints[robot.getJointId(name)].idx_q for name in model.joints]

    def smallest(q):
        full = pin.neutral(robot)
        full[:7], full[joints] = q[:7], q[model.q_index]
        pin.computeDistances(robot, data, geometry, distances, full)
        return min(result.min_distance for result in distances.distanceResults)

    return smallest


ARM = {"g1": ("shoulder", "elbow", "wrist"), "talos": ("arm_", "gripper_", "wrist_")}
HANDS = ("left_hand", "right_hand")


def adversarial(kind, base, rng):
    """Return goals of the hands: (position, position)."""
    (left, right) = base
    if kind == "torso":
        return np.array([0.0, -0.05, left[2] + 0.1]), np.array([0.0, 0.05, right[2] + 0.1])
    if kind == "cross":
        return np.array([left[0], right[1], left[2]]), np.array([right[0], left[1], right[2]])
    return tuple(
        np.array([rng.uniform(-0.2, 0.5), rng.uniform(-0.5, 0.5), left[2] + rng.uniform(-0.3, 0.5)]) for _ in range(2)
    )


def run(bench, kind, cycles, back=0):
    """Command the hands to colliding positions for some cycles, then back; return the motion."""
    model, controller = bench.model, bench.controller
    rest = bench.references(left_hand=5.0, right_hand=5.0)
    base = [rest.tasks[hand].position[:3] for hand in HANDS]
    rng, q, v = np.random.default_rng(6), np.array(bench.stance), np.zeros(model.nv)
    period, visited = controller.formulation.period, []
    for i in range(cycles + back):
        if i % 150 == 0 and i < cycles:
            goals = adversarial(kind, base, rng)
        if i == cycles:
            goals = base
        references = rest
        for hand, goal in zip(HANDS, goals, strict=True):
            references = demand(references, hand, position=np.concatenate([goal, rest.tasks[hand].position[3:]]))
        solution = controller.solve(bench.state(q, v), references)
        assert not solution.relaxed
        q = pin.integrate(model.pinocchio, q, period * v + 0.5 * period**2 * solution.v_dot)
        v = v + period * solution.v_dot
        visited.append((q, v, solution))
    return visited


@pytest.mark.parametrize(("robot", "kind"), [("g1", "torso"), ("talos", "cross"), ("g1", "random")])
def test_arms_keep_their_distance(bench, robot, kind):
    held, free = bench(robot, limits=settings(robot)), bench(robot)
    (limit,) = held.controller.formulation.row_limits
    of_arms = [name for name in limit._pair_names if any(part in name for part in ARM[robot])]
    smallest = distance_of_hulls(held.model, of_arms)
    visited = run(held, kind, 240 if kind == "random" else 150)
    assert any(name.startswith("self_collision:") for _, _, solution in visited for name in solution.binding)
    assert min(smallest(q) for q, _, _ in visited[::10]) > MARGIN
    without = run(free, kind, 100)
    assert min(smallest(q) for q, _, _ in without[50::10]) < 0.0  # collides without the limit


def test_hands_reach_free_goals(bench):
    visited = run(bench("g1", limits=settings("g1")), "torso", 100, back=300)
    (_, _, blocked), (_, _, last) = visited[99], visited[-1]
    assert min(blocked.task_errors[hand] for hand in HANDS) > 0.05
    assert max(last.task_errors[hand] for hand in HANDS) < 0.01
    assert not any(name.startswith("self_collision:") for name in last.binding)


@pytest.mark.parametrize(("rows", "spoilt"), [(0, False), (3, False), (3, True), (200, True)])
def test_pairs_with_the_largest_required_acceleration_have_a_row(every_pair, rows, spoilt):
    """In the order of the pairs; NaN comes last."""
    model, all_pairs = every_pair
    limit, dynamics, rng, period = another(model, all_pairs), Dynamics(model), np.random.default_rng(2), 0.002
    dynamics.update(model.configuration(model.posture), 2.0 * rng.normal(size=model.nv))
    find = limit._compute_near_distances

    def found(*args):
        near = find(*args)
        if spoilt:
            limit._distances[near[0]] = np.nan
        return near

    limit._compute_near_distances = found
    block, lower, upper = rng.normal(size=(rows, model.nv + 3)), rng.normal(size=rows), rng.normal(size=rows)
    C, rest = block[:, : model.nv], block[:, model.nv :].copy()
    limit.fill(dynamics, period, C, lower, upper)
    names, near = limit.names, limit._shapes.near[: limit.computed]
    near = near[~(limit._distances[near] > limit._shapes.reach[: len(near)])]
    J, rate, drift = limit._rows(dynamics, near)
    ahead = max(period, limit.horizon)
    bound = limit.bound(limit._distances[near], rate, ahead)
    needed = ~(bound < -SPEED_INCREASE / ahead)
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
        limit.fill(dynamics, period, C, lower, upper)
        assert limit.names is names  # the same pairs, the same names


@pytest.mark.parametrize("where", ["position", "velocity"])
def test_nan_states_are_refused_without_side_effects(bench, where):
    g1 = bench("g1", limits=settings("g1"))
    good = g1.controller.solve(g1.state(), g1.references())
    names = g1.controller.formulation.row_limits[0].names
    q, v = np.array(g1.stance), np.zeros(g1.model.nv)
    (q if where == "position" else v)[-3] = np.nan
    with pytest.raises(NoSolution, match="not finite"):
        g1.controller.solve(g1.state(q, v), g1.references())
    again = g1.controller.solve(g1.state(), g1.references())
    assert g1.controller.formulation.row_limits[0].names == names
    np.testing.assert_allclose(again.tau, good.tau, atol=1e-6)


def two_arms(torque):
    """Return a program, a state with closing spheres that must brake with 16 m/s², and references of rest.

    The robot has two arms of one joint each on a fixed base.
    """
    arms = (ball_link(name, "base", f"0 {y} 0", "1 0 0") for name, y in (("l0", 0.1), ("r0", -0.1)))
    model = build_model(robot(BASE, *arms), ["l0_joint", "r0_joint"], [0.0, 0.0], floating_base=False)
    geometry = build_collision_model(model, margin=MARGIN).geometry
    limit = SelfCollisionLimit(model, geometry, margin=MARGIN, acceleration=10.0, horizon=0.02, max_pairs=4)
    task = PostureTask("posture", model, (), stiffness=0.0, damping=0.0)
    formulation = Formulation(
        model, [task], [], TorqueLimit(np.full(2, torque), 1.0e4), JointMotionLimit(None, None, acceleration=500.0),
        [limit], period=0.002,
    )  # fmt: skip
    references = References({"posture": Reference(np.zeros(2), np.zeros(2), np.zeros(2))}, {"posture": 1.0}, {})
    return WholeBodyQP(formulation), RobotState(0, np.zeros(2), np.array([-2.0, 2.0])), references


def test_two_arms_brake_as_far_as_they_can():
    strong, *at = two_arms(20.0)
    assert conflict_of(strong, *at) is None
    solution = strong.solve(*at)
    assert list(solution.binding) == ["self_collision:l0/r0"]
    assert solution.v_dot[0] > 10.0
    assert not solution.relaxed
    weak, *at = two_arms(0.5)
    solution = weak.solve(*at)
    assert solution.relaxed == ("self_collision",)
    np.testing.assert_allclose(np.abs(solution.tau), 0.5, atol=1e-4)
    assert solution.v_dot[0] > 0.5
    assert solution.v_dot[1] < -0.5


def test_standing_feet_nearer_than_the_margin_are_named(bench):
    pair = "left_ankle_roll_link/right_ankle_roll_link"
    stands = bench("g1", limits={"self_collision": SelfCollisionSettings(enabled=True, pairs=[pair], margin=0.01)})
    (limit,) = stands.controller.formulation.row_limits
    limit.margin = 0.3
    why = conflict_of(stands.controller, stands.state(), stands.references())
    motions = {f"contact_motion:{foot}" for foot in stands.controller.contacts}
    assert set(why.conflict) == {f"self_collision:{pair}"} | motions
    assert "distance of left_ankle_roll_link and right_ankle_roll_link (has to change by at least" in why.sentence
    assert why.units[f"self_collision:{pair}"] == "m/s²"
