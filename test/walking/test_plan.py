"""Plan of the walker for viewers."""

import math

import numpy as np
import pytest
from gaits import run_to, simulated

from wbc_controller.walking.gait import Phase
from wbc_controller.walking.plan import margin, swing_path
from wbc_controller.walking.swing_kernels import Landing, at_rest

SQUARE = [0j, 2.0 + 0j, 2.0 + 1j, 1j]


@pytest.mark.parametrize(
    ("point", "corners", "distance"),
    [
        (1.0 + 0.5j, SQUARE, 0.5),
        (0.1 + 0.5j, [*SQUARE, 1.0 + 0.5j], 0.1),  # a corner inside the hull
        (0.3 + 0.5j, [*SQUARE, 1j], 0.3),  # a corner twice
        (1.0 + 0j, SQUARE, 0.0),
        (1.0 - 0.2j, SQUARE, -0.2),
        (1.0 + 0.1j, [0j, 2.0 + 0j], -0.1),  # two points of a trot
        (1.0 + 0j, [0j, 2.0 + 0j], 0.0),
    ],
)
def test_margin(point, corners, distance):
    assert margin(point, corners) == pytest.approx(distance)


def test_swing_path_ends_at_the_landing():
    foot, landing = at_rest(0.1j, 0.0, 0.0), Landing(0.3 + 0.12j, 0.01, 0.2, 0.5)
    path = swing_path(foot, landing, 0.05, 0.0)
    np.testing.assert_allclose(path[0], [0.0, 0.1, 0.0])
    np.testing.assert_allclose(path[-1], [0.3, 0.12, 0.01], atol=1e-6)
    assert path[:, 2].max() == pytest.approx(0.06, abs=0.005)


def test_plan_of_a_step():
    simulation, controller, walker = simulated("g1")
    assert walker.plan() is None
    controller.walk(0.3)
    simulation.run(0.4)
    shift = walker.plan()
    assert (shift.phase, dict(shift.landings), shift.remaining) == ("shift", {}, math.inf)
    assert 0.0 < shift.margin < 0.2
    run_to(simulation, Phase.SINGLE, 0.01)
    simulation.run(0.3)
    plan = walker.plan()
    assert plan.phase == "single support"
    (foot,) = plan.landings
    assert 0.0 < plan.margin <= 0.03
    assert 0.0 < plan.remaining < walker.gait.single
    assert abs(plan.dcm - plan.wanted_dcm) < 0.03
    sole = next(each for each in walker._feet.values() if each.contact == foot)
    np.testing.assert_allclose(plan.swings[foot][0], sole.pose(controller.dynamics).translation, atol=0.03)
    np.testing.assert_allclose(plan.swings[foot][-1], plan.landings[foot], atol=2e-3)
    run_to(simulation, Phase.DOUBLE, 0.01)
    assert walker.plan().phase == "double support"
    np.testing.assert_allclose(sole.pose(controller.dynamics).translation, plan.landings[foot], atol=0.03)
