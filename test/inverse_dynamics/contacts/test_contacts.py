import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from snapshots import dynamics_at

from wbc_controller.inverse_dynamics.contacts import PointContact, Polygon, Rectangle, SurfaceContact, wrench_cone
from wbc_controller.inverse_dynamics.contacts.support import friction_pyramid

FRAME = "left_ankle_roll_link"
RADIUS = 0.03


def placement_of(rng):
    return pin.SE3(pin.exp3(rng.normal(size=3)), 0.2 * rng.normal(size=3))


def test_support_points(g1, random_state):
    rng = np.random.default_rng(0)
    q, v = random_state(g1, rng)
    placement = placement_of(rng)
    dynamics = dynamics_at(g1, q, v)
    contact = SurfaceContact("foot", g1, FRAME, placement, Rectangle(0.1, 0.05))
    world = dynamics.placement(g1.frame_id(FRAME, "test")) * placement
    expected = {tuple(np.round(world.act(np.array([x, y, 0.0])), 9)) for x in (0.1, -0.1) for y in (0.05, -0.05)}
    assert {tuple(np.round(point, 9)) for point in contact.points(dynamics)} == expected
    ball = PointContact("foot", g1, FRAME, placement.translation, RADIUS)
    np.testing.assert_allclose(ball.points(dynamics), [world.translation - [0.0, 0.0, RADIUS]], atol=1e-12)


def corners(x, y):
    return [np.array([a * x, b * y, 0.0]) for a, b in itertools.product((1.0, -1.0), repeat=2)]


def grasp(x, y):
    """Return the map from corner forces (12,) to a wrench (6,)."""
    return np.hstack([np.vstack([np.eye(3), pin.skew(corner)]) for corner in corners(x, y)])


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
    contact = SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), Rectangle(0.1, 0.05), friction=0.8)
    np.testing.assert_allclose(contact.cone, wrench_cone(0.8 / math.sqrt(2.0), 0.1, 0.05))


@pytest.mark.parametrize("moment", [-9.0, 4.0])
def test_a_single_sole_has_half_of_the_yaw_moment(g1, moment):
    contact = SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), Rectangle(0.1, 0.05))
    wrench, yaw = np.array([20.0, -10.0, 300.0, 3.0, 8.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, moment])
    alone = contact.cone_for(1.0, alone=True)
    np.testing.assert_array_equal(alone[: len(contact.cone)], contact.cone)
    np.testing.assert_allclose((alone @ (wrench + yaw))[len(contact.cone) :], (contact.cone @ (wrench + 2.0 * yaw))[8:])


@pytest.mark.parametrize("share", [0.05, 0.6, 1.0])
@pytest.mark.parametrize("shape", ["ball", "rectangle", "polygon"])
def test_cone_for_a_share_of_the_friction_is_that_of_a_contact_with_this_friction(g1, shape, share):
    triangle = np.array([[0.1, 0.0], [-0.05, 0.06], [-0.04, -0.03]])
    support = Rectangle(0.1, 0.05) if shape == "rectangle" else Polygon(triangle, "sole")

    def contact(friction):
        if shape == "ball":
            return PointContact("foot", g1, FRAME, np.zeros(3), RADIUS, friction=friction)
        return SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), support, friction=friction)

    np.testing.assert_allclose(contact(0.8).cone_for(share, alone=False), contact(0.8 * share).cone, atol=1e-12)


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.05), (0.06, 0.06), (0.092, 0.03)])
def test_wrench_metric_equals_corner_forces(g1, x, y):
    contact = SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), Rectangle(x, y))
    wrench = np.random.default_rng(7).normal(size=6)
    forces = np.linalg.lstsq(grasp(x, y), wrench, rcond=None)[0]  # least squares
    np.testing.assert_allclose(grasp(x, y) @ forces, wrench, atol=1e-12)
    assert wrench @ (contact.metric * wrench) == pytest.approx(4.0 * forces @ forces)


@pytest.mark.parametrize("activation", [1.0, 0.4, 1.0e-3])
def test_activation_scales_the_largest_normal_force(g1, activation):
    bounds = {"min_normal_force": 20.0, "max_normal_force": 500.0}
    contact = SurfaceContact("foot", g1, FRAME, pin.SE3.Identity(), Rectangle(0.1, 0.05), **bounds)
    lower, upper = contact.bounds(activation)
    assert upper[2] == pytest.approx(activation * 500.0)
    assert lower[2] == pytest.approx(min(20.0, activation * 500.0))  # never an empty interval
    others = [0, 1, 3, 4, 5]
    assert (lower[others] == -np.inf).all()
    assert (upper[others] == np.inf).all()
