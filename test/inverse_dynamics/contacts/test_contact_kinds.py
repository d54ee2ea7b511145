"""Soles, balls, tilted planes, wheels, fixed contacts, contacts between links, and closed loops."""

import itertools
import math
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hand_contacts import HANDS, a_fixed, a_point, a_surface, a_wheel, random_place
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from refusals import refusal
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from snapshots import dynamics_at, random_state, rate_along

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics import contacts
from wbc_controller.inverse_dynamics.contacts.support import friction_pyramid

FRAME = "left_ankle_roll_link"
RADIUS = 0.03


def a_sole(model, x=0.1, y=0.05, **options):
    return contacts.SurfaceContact("foot", model, FRAME, pin.SE3.Identity(), contacts.Rectangle(x, y), **options)


def same_rows(first, second):
    distance = np.abs(first[:, None, :] - second[None, :, :]).max(axis=2)
    return len(first) == len(second) and distance.min(axis=0).max() < 1e-9 and distance.min(axis=1).max() < 1e-9


@hypothesis_settings(max_examples=30, derandomize=True)
@given(friction=st.floats(0.05, 1.5), x=st.floats(0.01, 0.3), y=st.floats(0.01, 0.3))
def test_polygon_cone_of_a_rectangle_is_the_closed_form(friction, x, y):
    C = contacts.polygon_wrench_cone(friction, contacts.Rectangle(x, y).vertices)
    assert same_rows(C, contacts.wrench_cone(friction, x, y))


def can_be_made(wrench, friction, vertices):
    """Return True if forces within the pyramids at the vertices give a wrench, by a linear program."""
    edges = itertools.product((1.0, -1.0), repeat=2)
    forces = [np.array([a * friction, b * friction, 1.0]) for a, b in edges]
    rays = [np.append(force, np.cross([*vertex, 0.0], force)) for vertex in vertices for force in forces]
    return linprog(np.zeros(len(rays)), A_eq=np.array(rays).T, b_eq=wrench, method="highs").status == 0


@hypothesis_settings(max_examples=30, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), friction=st.floats(0.1, 1.2))
def test_polygon_cone_contains_exactly_the_wrenches_of_vertex_forces(seed, friction):
    rng = np.random.default_rng(seed)
    points = 0.1 * rng.normal(size=(int(rng.integers(3, 9)), 2)) + 0.1 * rng.normal(size=2)
    vertices = contacts.Polygon(points[ConvexHull(points).vertices], "vertices").vertices
    C = contacts.polygon_wrench_cone(friction, vertices)
    middle = vertices.mean(axis=0)
    upright = np.array([0.0, 0.0, 1.0, middle[1], -middle[0], 0.0])
    direction = rng.normal(size=6) * [friction, friction, 0.0, 0.1, 0.1, 0.1 * friction]
    rate, room = C @ direction, -C @ upright
    assert (room > 0.0).all()
    reach = np.min(room[rate > 0] / rate[rate > 0])
    assert can_be_made(upright + (1.0 - 1.0e-4) * reach * direction, friction, vertices)
    assert not can_be_made(upright + (1.0 + 1.0e-4) * reach * direction, friction, vertices)


def test_vertices_in_any_order():
    corners = np.array([[0.1, 0.0], [-0.1, 0.05], [0.05, 0.06], [0.0, -0.07], [-0.1, -0.05]])
    rng = np.random.default_rng(0)
    C = contacts.Polygon(corners, "vertices").cone(0.5)
    for _ in range(5):
        other = contacts.Polygon(rng.permutation(corners), "vertices")
        assert same_rows(other.cone(0.5), C)
        edges = np.roll(other.vertices, -1, axis=0) - other.vertices
        turns = np.linalg.det(np.stack([edges, np.roll(edges, -1, axis=0)], axis=1))
        assert (turns > 0.0).all()  # in order around the polygon


@pytest.mark.parametrize(
    ("vertices", "said"),
    [
        ([[0, 0], [0.1, 0]], "has 2 vertices; a polygon needs at least three"),
        ([[0, 0], [0.1, 0.1], [0.2, 0.2]], "the vertices are on one line"),
        ([[0, 0], [0.1, 0], [0.1, 0.1], [0.02, 0.01]], r"key\[3\] = \[0.02, 0.01\]: not a corner"),
        ([[0, 0], [0.1, 0], [0.05, 0.02], [0.1, 0.1], [0, 0.1]], r"key\[2\] = \[0.05, 0.02\]: not a corner"),
        ([[0, 0], [0.1, 0], [0.05, 0], [0, 0.1]], r"key\[2\] = \[0.05, 0.0\]: not a corner"),
        ([[0, 0], [0.1, 0], [0, 0.1], [0.1, 0]], r"key\[1\] = \[0.1, 0.0\]: not a corner"),
    ],
)
def test_invalid_polygons_are_refused(vertices, said):
    with pytest.raises(ConfigurationError, match=said):
        contacts.Polygon(np.array(vertices, dtype=float), "key")


def test_support_points(g1):
    rng = np.random.default_rng(0)
    q, v = random_state(g1, rng)
    placement = random_place(rng)
    dynamics = dynamics_at(g1, q, v)
    contact = contacts.SurfaceContact("foot", g1, FRAME, placement, contacts.Rectangle(0.1, 0.05))
    world = dynamics.placement(g1.frame_id(FRAME, "test")) * placement
    expected = {tuple(np.round(world.act(np.array([x, y, 0.0])), 9)) for x in (0.1, -0.1) for y in (0.05, -0.05)}
    assert {tuple(np.round(point, 9)) for point in contact.points(dynamics)} == expected
    ball = contacts.PointContact("foot", g1, FRAME, placement.translation, RADIUS)
    np.testing.assert_allclose(ball.points(dynamics), [world.translation - [0.0, 0.0, RADIUS]], atol=1e-12)


def grasp(x, y):
    """Return the map from corner forces (12,) to a wrench (6,)."""
    corners = [np.array([a * x, b * y, 0.0]) for a, b in itertools.product((1.0, -1.0), repeat=2)]
    return np.hstack([np.vstack([np.eye(3), pin.skew(corner)]) for corner in corners])


@given(friction=st.floats(0.05, 2.0), fx=st.floats(-2, 2), fy=st.floats(-2, 2), fz=st.floats(-1, 2))
def test_friction_pyramid_is_inside_the_friction_cone(friction, fx, fy, fz):
    inside = (friction_pyramid(friction) @ [fx, fy, fz]).max()
    if inside <= 0.0:
        assert math.hypot(fx, fy) <= friction * fz + 1.0e-9
    if math.hypot(fx, fy) <= 0.923 * friction * fz:
        assert inside <= 1.0e-9


@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_friction_pyramid_touches_the_friction_cone(friction):
    for angle in np.arange(8) * math.pi / 4.0:
        values = friction_pyramid(friction) @ [friction * math.cos(angle), friction * math.sin(angle), 1.0]
        assert values.max() == pytest.approx(0.0, abs=1e-12)


def test_surface_cone_keeps_corner_forces_within_coulomb_friction(g1):
    contact = a_sole(g1, friction=0.8)
    np.testing.assert_allclose(contact.cone, contacts.wrench_cone(0.8 / math.sqrt(2.0), 0.1, 0.05))


@pytest.mark.parametrize("moment", [-9.0, 4.0])
def test_a_single_sole_has_half_of_the_yaw_moment(g1, moment):
    contact = a_sole(g1)
    wrench, yaw = np.array([20.0, -10.0, 300.0, 3.0, 8.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, moment])
    alone = contact.cone_for(1.0, alone=True)
    np.testing.assert_array_equal(alone[: len(contact.cone)], contact.cone)
    np.testing.assert_allclose((alone @ (wrench + yaw))[len(contact.cone) :], (contact.cone @ (wrench + 2.0 * yaw))[8:])


@pytest.mark.parametrize("share", [0.05, 0.6, 1.0])
@pytest.mark.parametrize("shape", ["ball", "rectangle", "polygon"])
def test_cone_for_a_share_of_the_friction_is_that_of_a_contact_with_this_friction(g1, shape, share):
    triangle = np.array([[0.1, 0.0], [-0.05, 0.06], [-0.04, -0.03]])
    support = contacts.Rectangle(0.1, 0.05) if shape == "rectangle" else contacts.Polygon(triangle, "sole")

    def contact(friction):
        if shape == "ball":
            return contacts.PointContact("foot", g1, FRAME, np.zeros(3), RADIUS, friction=friction)
        return contacts.SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), support, friction=friction)

    np.testing.assert_allclose(contact(0.8).cone_for(share, alone=False), contact(0.8 * share).cone, atol=1e-12)


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.05), (0.06, 0.06), (0.092, 0.03)])
def test_wrench_metric_equals_corner_forces(g1, x, y):
    contact = a_sole(g1, x, y)
    wrench = np.random.default_rng(7).normal(size=6)
    forces = np.linalg.lstsq(grasp(x, y), wrench, rcond=None)[0]  # least squares
    np.testing.assert_allclose(grasp(x, y) @ forces, wrench, atol=1e-12)
    assert wrench @ (contact.metric * wrench) == pytest.approx(4.0 * forces @ forces)


@pytest.mark.parametrize("activation", [1.0, 0.4, 1.0e-3])
def test_activation_scales_the_largest_normal_force(g1, activation):
    lower, upper = a_sole(g1, min_normal_force=20.0, max_normal_force=500.0).bounds(activation)
    assert upper[2] == pytest.approx(activation * 500.0)
    assert lower[2] == pytest.approx(min(20.0, activation * 500.0))  # never an empty interval
    others = [0, 1, 3, 4, 5]
    assert (lower[others] == -np.inf).all()
    assert (upper[others] == np.inf).all()


def test_bounds_of_yaw_moment_and_fixed_contact(g1):
    lower, upper = a_sole(g1, max_yaw_moment=4.0).bounds(0.25)
    assert (lower[5], upper[5]) == (-1.0, 1.0)
    assert a_sole(g1).bounds(0.25)[1][5] == np.inf
    hand = a_fixed([1, 0, 1, 0, 1, 0])(g1, np.random.default_rng(0), max_force=200.0, max_moment=10.0)
    lower, upper = hand.bounds(0.5)
    np.testing.assert_array_equal(upper, [100.0, 100.0, 5.0])
    np.testing.assert_array_equal(lower, -upper)
    np.testing.assert_array_equal(hand.basis @ [1.0, 2.0, 3.0], [1.0, 0.0, 2.0, 0.0, 3.0, 0.0])
    assert (hand.bound_groups, len(hand.cone)) == ((("force", 0, 2), ("moment", 2, 3)), 0)


ALL = [1, 1, 1, 1, 1, 1]


def a_loop(mask):
    return lambda model, rng: contacts.LoopClosure("c", model, HANDS, (random_place(rng), random_place(rng)), mask)


KINDS = {
    "surface": a_surface,
    "point": lambda model, rng: contacts.PointContact("c", model, HANDS[0], rng.normal(size=3), 0.05),
    "surface against a link": partial(a_surface, against=HANDS[1]),
    "point on a slope": a_point,
    "point against a link": partial(a_point, against=HANDS[1]),
    "wheel": lambda model, rng: contacts.RollingContact(
        "c", model, HANDS[0], rng.normal(size=3), 0.1, rng.normal(size=3)
    ),
    "wheel on a slope": a_wheel,
    "wheel against a link": partial(a_wheel, against=HANDS[1]),
    "fixed": a_fixed(ALL),
    "fixed, some axes": a_fixed([0, 1, 1, 0, 1, 0]),
    "fixed to a link": partial(a_fixed(ALL), against=HANDS[1]),
    "loop": a_loop(ALL),
    "hinge": a_loop([1, 1, 1, 0, 1, 1]),
}


def velocity_by_differences(contact, model, q, v):
    """Return the velocity of a ball or wheel along the axes of its force, by finite differences."""
    middle = dynamics_at(model, q, v)
    touching = contact.points(middle)[0]

    def of_link(frame):
        """Return the velocity of the material point of a link at the contact, world axes."""
        fixed = middle.placement(frame).actInv(touching)
        return rate_along(lambda dynamics: dynamics.placement(frame).act(fixed), model, q, v, 1.0e-6)

    velocity = of_link(contact._frame_id)
    if contact._other is not None:
        velocity -= of_link(contact._other)
    return contact.axes(middle).T @ velocity


@pytest.mark.parametrize(("stiffness", "rotation"), [(0.0, 50.0), (100.0, 20.0)])
def test_a_sole_without_anchor_is_damped_more_in_rotation(g1, stiffness, rotation):
    sole = a_surface(g1, np.random.default_rng(0), stiffness=stiffness)
    np.testing.assert_array_equal(sole.row_damping(), np.repeat([20.0, rotation], 3))
    np.testing.assert_array_equal(a_point(g1, np.random.default_rng(0)).row_damping(), np.full(3, 20.0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_jacobian_and_drift_are_the_contact_velocity_and_its_rate(g1, kind, seed):
    """Velocities of other kinds: `test_anchors` (displacements) and `test_open_loop_closes_with_its_stiffness`."""
    rng = np.random.default_rng(seed)
    contact = KINDS[kind](g1, rng)
    q, v = random_state(g1, rng)
    dynamics = dynamics_at(g1, q, v)
    J, drift = contact.jacobian(dynamics), contact.drift(dynamics)
    assert J.shape == (contact.size, g1.nv)
    if kind.startswith(("point", "wheel")):
        expected = velocity_by_differences(contact, g1, q, v)
        assert np.abs(J @ v - expected).max() < 1.0e-6 * max(1.0, np.abs(expected).max())
    expected = rate_along(lambda dynamics: contact.jacobian(dynamics) @ v, g1, q, v, 1.0e-5)
    assert np.linalg.norm(drift - expected) < 2.0e-6 * max(1.0, np.linalg.norm(expected))


@pytest.mark.parametrize("kind", KINDS)
def test_force_and_wrench_have_the_same_power(g1, kind):
    """Compare fᵀ J v with the power of the world wrench; between links, on the first link."""
    rng = np.random.default_rng(3)
    contact = KINDS[kind](g1, rng)
    q, v = random_state(g1, rng)
    dynamics, force = dynamics_at(g1, q, v), rng.normal(size=contact.size)
    wrench = contact.wrench_in_world(dynamics, force)
    feels = [HANDS[1], HANDS[0]] if isinstance(contact, contacts.LoopClosure) else [HANDS[0], HANDS[1]]
    J = [dynamics.jacobian(g1.pinocchio.getFrameId(name), pin.WORLD) for name in feels]
    generalized = J[0].T @ wrench - (J[1].T @ wrench if contact.internal else 0.0)
    np.testing.assert_allclose(contact.jacobian(dynamics).T @ force, generalized, atol=1e-9)
    assert contact.internal == ("link" in kind or kind in ("loop", "hinge"))


@pytest.mark.parametrize("seed", range(4))
def test_open_loop_closes_with_its_stiffness(g1, seed):
    """ė = J v near closure, so γ̇ = -D γ - K e decays critically."""
    rng = np.random.default_rng(seed)
    q, v = random_state(g1, rng)
    dynamics = dynamics_at(g1, q, v)
    a, b = (dynamics.placement(g1.pinocchio.getFrameId(name)) for name in HANDS)
    place = random_place(rng)
    small = pin.exp6(1.0e-4 * rng.normal(size=6))
    turned = pin.SE3(pin.exp3(np.array([2.5, 0.0, 0.0])), np.zeros(3))  # the hinge is far from its zero
    for mask, joint in ([1] * 6, pin.SE3.Identity()), ([1, 1, 1, 0, 1, 1], turned), ([1, 1, 1, 0, 0, 0], turned):
        loop = contacts.LoopClosure("l", g1, HANDS, (place, b.actInv(a * place * joint * small)), mask, stiffness=100.0)
        assert np.abs(loop.error(dynamics)).max() < 1.0e-3
        J = loop.jacobian(dynamics)
        rate = rate_along(loop.error, g1, q, v, 1e-6)
        np.testing.assert_allclose(rate, J @ v, atol=2.0e-3 * max(1.0, np.abs(J @ v).max()))
        expected = -loop.drift(dynamics) - 20.0 * (J @ v) - 100.0 * loop.error(dynamics)
        np.testing.assert_allclose(loop.acceleration_at_rest(dynamics) - loop.damping * J @ v, expected)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (partial(contacts.FixedContact, mask=[False] * 6), "at least one axis must be held"),
        (
            partial(contacts.PointContact, radius=0.1, normal=[0, 0, 0]),
            "contacts.c.normal = [0, 0, 0]: the length must not be 0",
        ),
        (
            partial(contacts.RollingContact, radius=0.1, axis=np.full(3, np.nan)),
            "contacts.c.axis = [nan, nan, nan]: the length must not be 0",
        ),
    ],
)
def test_invalid_contacts_are_refused(g1, make, said):
    assert said in refusal(make, "c", g1, HANDS[0], np.zeros(3))
