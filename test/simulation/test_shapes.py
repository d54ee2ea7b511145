"""The mock robot touches the floor with the URDF's shapes and reveals wrong configurations."""

import numpy as np
import pytest
from robot_cases import joint, link, robot
from stepping import simulate

import wbc_controller as wbc
from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import WbcError
from wbc_controller.settings import Settings
from wbc_controller.simulation import shapes
from wbc_controller.simulation.plant import Plant

SIDES = ("left", "right")
PUSH = [180.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # for a tenth of a second: the demo's shove forward
SURFACE = {"type": "surface", "frame": "foot", "half_length": 0.1, "half_width": 0.05, "max_normal_force": 500.0}


def talos(**feet):
    return wbc.load("talos").replace({f"contacts.{side}_foot.{key}": feet[key] for side in SIDES for key in feet})


def stands(robot: wbc.Simulation, push: list[float]) -> bool:
    """Return True if the soles move by less than 2 cm during a push."""
    places = {name: robot.plant.foot_placement(name).translation for name in robot.plant.contacts}
    try:
        robot.run(0.1)
        robot.plant.push("base_link", push, 0.1)
        robot.run(0.9)
    except WbcError:  # the controller has given up
        return False
    moved = [np.linalg.norm(robot.plant.foot_placement(name).translation - at) for name, at in places.items()]
    return not robot.plant.fallen and max(moved) < 0.02


def test_a_push_that_talos_stands_overturns_it_on_smaller_soles_and_moves_it_on_less_friction():
    assert stands(wbc.Simulation(talos()), PUSH)
    assert not stands(wbc.Simulation(talos(half_length=0.3, half_width=0.2)), PUSH)
    assert not stands(wbc.Simulation(talos().replace({"mock.friction": 0.07})), PUSH)


def test_a_sole_configured_at_the_ankle():
    """The real sole is 10.7 cm away from the configured one."""
    config = wbc.load("talos").replace({f"contacts.{side}_foot.frame": f"leg_{side}_6_link" for side in SIDES})
    plant = Plant(make_model(config.settings), config.settings)
    for side in SIDES:
        assert plant.foot_placement(f"{side}_foot").translation[2] == pytest.approx(0.107, abs=0.001)


def made(collision: str, contacts: dict | None = None) -> Plant:
    contacts = {"sole": SURFACE} if contacts is None else contacts
    values = {"robot": {"joints": ["j"], "posture": [0.0]}, "contacts": contacts, "mock": {"friction": 0.4}}
    settings = Settings.model_validate(values | {"tasks": {"posture": {"type": "posture"}}})
    parts = link("foot", 5.0, inertia=0.1, more=collision), link("top", 1.0, inertia=0.1)
    urdf = robot(*parts, joint("j", "foot", "top", "0 0 1", limit='lower="-1" upper="1" effort="9" velocity="9"'))
    plant = Plant(make_model(settings, urdf), settings)
    plant.hold(False, ramp=0.0)
    return plant


def collision(shape: str, xyz: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry>{shape}</geometry></collision>'


@pytest.mark.parametrize(
    ("shape", "height"),
    [
        ('<box size="0.3 0.2 0.1"/>', 0.05),
        ('<sphere radius="0.07"/>', 0.07),
        ('<cylinder radius="0.07" length="0.2"/>', 0.1),
    ],
)
def test_primitives_touch_as_they_are(shape, height):
    plant = made(collision(shape, "0.01 0.02 0.03"))
    assert plant.state()[0][2] == pytest.approx(height - 0.03, abs=1e-6)
    simulate(plant, 100)
    assert plant.contact_wrenches()["sole"][2] == pytest.approx(6.0 * 9.81, rel=0.02)  # the ball rolls


def test_a_mesh_stands_on_its_hull(tmp_path):
    """A tetrahedron of 0.1 m with one face down."""
    corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.02, 0.02, 0.1]]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 3 1 4"]
    (tmp_path / "foot.obj").write_text("\n".join(lines))
    plant = made(collision(f'<mesh filename="{tmp_path}/foot.obj"/>', "-0.02 -0.02 -0.1"))
    assert plant.state()[0][2] == pytest.approx(0.1, abs=1e-6)
    simulate(plant, 200)
    assert plant.contact_wrenches()["sole"][2] == pytest.approx(6.0 * 9.81, rel=1e-3)
    assert plant.state()[0][2] == pytest.approx(0.1, abs=1e-4)


def test_links_without_shapes_use_the_configuration(caplog):
    plant = made("")
    assert [record.message for record in caplog.records if "contacts sole have no collision element" in record.message]
    assert plant.state()[0][2] == pytest.approx(0.0, abs=1e-6)
    assert len(plant.contact_forces.geoms["sole"]) == 4


def test_a_touch_belongs_to_the_nearest_contact_of_the_link():
    part = SURFACE | {"half_length": 0.05}
    feet = {name: part | {"translation": [x, 0.0, -0.05]} for name, x in (("toe", 0.1), ("heel", -0.1))}
    plant = made(collision('<box size="0.4 0.1 0.1"/>'), feet)
    simulate(plant, 100)
    assert [wrench[2] for wrench in plant.contact_wrenches().values()] == pytest.approx([3.0 * 9.81] * 2, rel=1e-2)


def ball(n: int) -> np.ndarray:
    """Points on a ball of 2 cm about (0.1, 0, 0), (n, 3)."""
    height = np.linspace(-1.0, 1.0, n)
    turn = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - height**2)
    return np.array([0.1, 0.0, 0.0]) + 0.02 * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])


def test_a_round_tip_is_one_ball_and_a_flat_mesh_a_thin_box():
    balls, rest = shapes._split_tip(ball(300), np.array([0.0, 0.0, -1.0]))
    assert len(rest) == 0
    assert balls[0].size[0] == pytest.approx(0.02, abs=1e-6)
    np.testing.assert_allclose(balls[0].placement.translation, [0.1, 0.0, 0.0], atol=1e-6)
    box = np.array(np.meshgrid([0.0, 0.1], [0.0, 0.1], [0.0, 0.1])).reshape(3, -1).T
    assert shapes._split_tip(box, np.array([0.0, 0.0, -1.0]))[0] == []
    shape = shapes._mesh(np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.1, 0.0], [0.0, 0.1, 0.0]]))
    assert shape.points is None
    np.testing.assert_allclose(shape.placement.translation, [0.1, 0.05, 0.0])
    np.testing.assert_allclose(shape.size[:2], [0.1, 0.05])


def test_soles_are_parted_once_into_a_flat_outline():
    rng = np.random.default_rng(0)
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    sole = np.column_stack([0.1 * np.cos(angle), 0.05 * np.sin(angle), rng.uniform(0.0, 0.0015, 60)])
    sole[0, 2] = 0.0
    down = np.array([0.0, 0.0, -1.0])
    balls, behind = shapes._split_sole(np.vstack([sole, [[0.0, 0.0, 0.1]]]), down, 0.0)
    assert len(balls) == shapes.MOST_CORNERS
    corners = np.array([ball.placement.translation for ball in balls])
    np.testing.assert_allclose(corners[:, 2], shapes.CORNER_RADIUS)
    x, y = corners[:, 0], corners[:, 1]
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area > 0.94 * np.pi * 0.1 * 0.05  # twelve corners in an ellipse have 0.955 of it at best
    assert behind[:, 2].min() == pytest.approx(shapes.SOLE_DEPTH)
    tilted, side = np.array([0.0, np.sin(0.03), -np.cos(0.03)]), np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(shapes._distinct_normals([down, tilted, side]), [down, side])
