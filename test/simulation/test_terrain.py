"""Terrain of the mock robot: heights of blocks in closed form, soft ground, local friction, and falls."""

import mujoco
import numpy as np
import pytest

from wbc_controller.settings.config import load as load_config
from wbc_controller.settings.service import TerrainSettings
from wbc_controller.simulation.mechanism import blocks
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.simulation import Simulation

TILT = 0.1
FLAT = {"position": [-1.0, 0.0, 0.3], "size": [3.0, 3.0, 0.2]}


def plant_on(load, **block):
    model, settings = load("g1")
    return Plant(model, load_config(settings).replace({"mock.terrain": {"ground": block}}).settings)


def upper_height(block, x, y):
    """Height of the upper face of the block's box at a place, m."""
    ((placement, half),) = blocks(TerrainSettings(**block))
    normal, top = placement.rotation[:, 2], placement.act(np.array([0.0, 0.0, half[2]]))
    return top[2] - (normal[:2] @ (np.array([x, y]) - top[:2])) / normal[2]


def test_a_block_begins_at_its_edge_and_cells_cover_it_at_heights_in_their_range():
    for rpy, x, y, rise in (
        ([0.0, -TILT, 0.0], 2.0, 1.0, 2.0 * np.tan(TILT)),  # ascends along x from the edge
        ([0.0, TILT, 0.0], 2.0, 1.0, -2.0 * np.tan(TILT)),
        ([0.0, -TILT, 0.5 * np.pi], 0.5, 2.0, 2.0 * np.tan(TILT)),  # ascends along y
    ):
        block = {"position": [0.0, 0.0, 0.3], "size": [3.0, 3.0, 0.2], "rpy": rpy}
        assert upper_height(block, 0.0, 0.0) == pytest.approx(0.3, abs=1e-12)
        assert upper_height(block, x, y) == pytest.approx(0.3 + rise, abs=1e-12)
    terrain = TerrainSettings(position=[1.0, 2.0, 0.1], size=[3.0, 1.2, 0.1], unevenness=0.02, cell=0.3, seed=4)
    found = blocks(terrain)
    assert len(found) == 40
    tops = np.array([placement.translation[2] + half[2] for placement, half in found])
    assert np.abs(tops - 0.1).max() <= 0.02
    assert tops.std() > 0.008
    places = np.array([placement.translation[:2] for placement, _ in found])
    np.testing.assert_allclose(places.min(axis=0), [1.15, 1.55])
    np.testing.assert_allclose(places.max(axis=0), [3.85, 2.45])
    other = blocks(terrain.model_copy(update={"seed": 5}))
    assert not np.allclose([placement.translation[2] for placement, _ in other], tops - 0.05)


def test_a_robot_starts_on_a_slope_and_a_block_has_its_own_friction(load):
    plant = plant_on(load, position=[-2.0, 0.0, 0.0], size=[4.0, 4.0, 0.1], rpy=[0.0, -TILT, 0.0])
    touch = plant.contact_forces
    assert touch.distance(plant.data, touch.on_the_floor) == pytest.approx(0.0, abs=1e-6)
    balls = [g for g in touch.on_the_floor if plant.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE]
    heights = plant.data.geom_xpos[balls, 2] - (2.0 + plant.data.geom_xpos[balls, 0]) * np.tan(TILT)
    assert (heights - plant.model.geom_size[balls, 0] / np.cos(TILT)).min() == pytest.approx(0.0, abs=1e-5)
    plant = plant_on(load, **FLAT, friction=0.3)
    plant.step()
    assert {contact.friction[0] for contact in plant.data.contact} == {0.3}


def test_a_robot_starts_on_a_block_and_a_fall_is_relative_to_the_feet(load):
    model, _ = load("g1")
    flat, plant = Plant(*load("g1")), plant_on(load, **FLAT)
    q, v = plant.state()
    assert q[2] - flat.state()[0][2] == pytest.approx(0.3, abs=1e-6)
    assert not plant.fallen
    q[2] -= 0.5  # the robot goes down with its ground
    plant.set_state(q, v)
    assert not plant.fallen
    for part, angle in (("hip_pitch", -2.2), ("knee", 2.8)):
        q[[index for index, name in zip(model.q_index, model.joints, strict=True) if part in name]] = angle
    plant.set_state(q, v)
    assert plant.fallen
    q, v = flat.state()
    q[2] += 1.0
    for degrees, fallen in ((69.0, False), (71.0, True)):  # a tilt of 70 degrees is a fall
        half = np.radians(0.5 * degrees)
        q[3:7] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        flat.set_state(q, v)
        assert flat.fallen is fallen


def test_soft_ground_yields_by_its_stiffness():
    stiffness = 1.0e4
    simulation = Simulation(load_config("g1").replace({"mock.terrain": {"mat": {**FLAT, "stiffness": stiffness}}}))
    simulation.run(1.0)
    plant = simulation.plant
    weight = sum(wrench[2] for wrench in plant.contact_wrenches().values())
    corners = sum(map(len, plant.contact_forces.geoms.values()))
    depths = [-contact.dist for contact in plant.data.contact]
    assert len(depths) == corners
    assert np.mean(depths) == pytest.approx(weight / (corners * stiffness), rel=0.02)
