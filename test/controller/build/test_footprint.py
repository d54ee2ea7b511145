"""Footprints of boxes, balls, cylinders and feet of shipped robots on planes."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from robot_cases import joint, robot
from urdf_models import build_model, link

from wbc_controller.controller.build.collision_elements import read_collision_elements
from wbc_controller.controller.build.footprint import LAYER, footprint, outline


def on_plane(height, turn=(0.0, 0.0, 0.0), *, shank=(), foot=(), layer=LAYER):
    """Return the footprint, on a plane, of a base, a shank, and a foot fixed 0.5 m below the joint."""
    links = link("base") + link("shank", *shank) + link("foot", *foot, inertial="")
    ankle = joint("ankle", "shank", "foot", at="0 0 -0.5", kind="fixed", limit="")
    urdf = robot(links, joint("knee", "base", "shank"), ankle)
    elements = read_collision_elements(build_model(urdf, ["knee"], [0.0]), urdf, "test")
    return footprint(elements, pin.SE3(pin.rpy.rpyToMatrix(np.array(turn)), np.array([0.0, 0.0, height])), layer)


SOLE = ("0.02 0 0.02", "0 0 0", '<box size="0.2 0.1 0.04"/>')
LEG = ("0 0 -0.25", "0 0 0", '<cylinder radius="0.03" length="0.4"/>')
BALL = ("0 0 0", "0 0 0", '<sphere radius="0.03"/>')
LYING = ("0 0 0", "0 1.5707963267948966 0", '<cylinder radius="0.02" length="0.3"/>')


def test_footprint_of_a_sole_in_the_axes_of_the_plane():
    found = on_plane(-0.51, shank=(LEG,), foot=(SOLE,))
    assert found.polygon.min(axis=0) == pytest.approx([-0.08, -0.05])
    assert found.polygon.max(axis=0) == pytest.approx([0.12, 0.05])
    assert found.size == pytest.approx([0.2, 0.1])
    assert found.height == pytest.approx(0.01)
    assert found.tilt == pytest.approx(0.0, abs=1e-9)
    found = on_plane(-0.5, (0.0, 0.0, np.pi / 2), foot=(SOLE,))
    assert found.size == pytest.approx([0.1, 0.2])
    assert found.polygon.max(axis=0) == pytest.approx([0.05, 0.08])
    found = on_plane(-0.5, (0.0, 0.3, 0.0), foot=(SOLE,))
    assert found.size[0] < 0.02
    assert found.size[1] == pytest.approx(0.1)


@pytest.mark.parametrize("angle", [0.02, 0.1, -0.3])
def test_the_tilt_is_that_of_the_sole_against_the_plane(angle):
    assert on_plane(-0.5, (0.0, angle, 0.0), shank=(LEG,), foot=(SOLE,)).tilt == pytest.approx(abs(angle))


def test_balls_at_the_corners_of_a_sole_touch_at_their_lowest_points():
    corners = [(0.1, 0.03), (0.1, -0.03), (-0.1, 0.025), (-0.1, -0.025)]
    ball = '<sphere radius="0.005"/>'
    found = on_plane(-0.505, foot=[(f"{x} {y} 0", "0 0 0", ball) for x, y in corners])
    assert found.height == pytest.approx(0.0, abs=1e-12)
    assert {tuple(corner) for corner in found.polygon.round(6)} == set(corners)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_lowest_point_of_a_ball_on_tilted_planes(turn):
    found = on_plane(-0.5, turn, foot=(BALL,), layer=1e-6)
    assert found.height == pytest.approx(-0.03)
    assert found.polygon == pytest.approx(np.zeros((1, 2)), abs=1e-6)
    assert found.tilt is None


def test_cylinders_and_capsules():
    wheel = ("0 0 0", "1.5707963 0 0", '<cylinder radius="0.1" length="0.04"/>')
    lean = 0.2
    found = on_plane(-0.5, (lean, 0.0, 0.0), foot=(wheel,))
    assert found.height == pytest.approx(-0.1 * np.cos(lean) - 0.02 * np.sin(lean), abs=1e-4)
    element = pin.GeometryObject("rod", 0, 0, pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), np.zeros(3)),
                                 coal.Capsule(0.02, 0.3))  # fmt: skip
    points = outline(element)
    assert points.min(axis=0) == pytest.approx([-0.17, -0.02, -0.02])
    assert points.max(axis=0) == pytest.approx([0.17, 0.02, 0.02])
    found = on_plane(-0.5, foot=(LYING,), layer=1e-6)
    assert found.height == pytest.approx(-0.02)
    assert np.sort(found.polygon[:, 0]) == pytest.approx([-0.15, 0.15])


def test_how_far_points_are_outside():
    points = np.array([[0.02, 0.0], [0.12, 0.05], [0.15, 0.0], [0.15, 0.09], [-0.18, 0.0]])
    assert on_plane(-0.5, foot=(SOLE,)).outside(points) == pytest.approx([0.0, 0.0, 0.03, 0.05, 0.1], abs=1e-12)
    ball = on_plane(-0.5, foot=(BALL,), layer=1e-6)
    assert ball.outside(np.array([[0.03, 0.04]])) == pytest.approx([0.05], abs=1e-5)
    line = on_plane(-0.5, foot=(LYING,), layer=1e-6)
    assert line.outside(np.array([[0.0, 0.04], [0.0, 0.0]])) == pytest.approx([0.04, 0.0], abs=1e-5)
    assert on_plane(0.0) is None


def test_a_mesh_is_outlined_by_its_vertices(robot_of):
    _, model = robot_of("talos")
    elements = read_collision_elements(model, model.urdf, "test")
    frame = model.frame_id("leg_left_6_link", "test")
    (sole,) = [element for element in elements if element.parentFrame == frame]
    assert len(outline(sole)) == len(sole.geometry.vertices())
