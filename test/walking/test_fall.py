"""Prediction of falls: reach of the steps, and robots that are pushed."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from gaits import GAIT, simulated, walking
from stepping import simulate

from wbc_controller.errors import NoSolution
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.walking.adaptation_kernels import SHORTEST
from wbc_controller.walking.fall_kernels import MARGIN, missed, nearest_support
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.pendulum_kernels import later

GAIT = replace(GAIT, greatest_width=0.4)


@pytest.mark.parametrize(
    ("dcm", "soles", "nearest"),
    [
        (0.5 + 0.2j, [0j], 0.1 + 0.05j),
        (0.02 + 0.01j, [0j], 0.02 + 0.01j),
        (0.5 + 0.1j, [0j, 0.2j], 0.1 + 0.1j),  # beside the line between the soles
        (0.4j - 0.05, [0j, 0.2j], 0.2j + 0.1 * (0.2j - 0.05) / abs(0.2j - 0.05)),
        (0.02 + 0.1j, [0j, 0.2j], 0.02 + 0.1j),
    ],
)
def test_nearest_point_of_the_support(dcm, soles, nearest):
    turned = cmath.rect(1.0, 0.3)
    first, second = (2.0 + place * turned for place in (soles[0], soles[-1]))
    found = nearest_support(2.0 + dcm * turned, first, second, 0.3, 0.1, 0.05)
    assert found == pytest.approx(2.0 + nearest * turned)


@pytest.mark.parametrize("time", [0.0, 0.1, 0.3])
@pytest.mark.parametrize(("excess", "falls"), [(-0.01, False), (0.01, True)])
def test_steps_capture_the_dcm_up_to_the_largest_distance(time, excess, falls):
    """Steps of the largest length at the shortest time bring the DCM nearer from just below, and lose it from above."""
    omega, step_time, half = 3.8, SHORTEST * GAIT.single + GAIT.double, (0.1, 0.05)
    most = GAIT.length / (math.exp(omega * step_time) - 1.0)
    dcm = later(GAIT.length + most + excess, half[0], omega, -time)  # the centre of pressure is at the edge of the sole
    sizes = replace(GAIT, single=SHORTEST * GAIT.single, greatest_width=GAIT.length).sizes
    distance, limit = missed(dcm, 0j, 0.0, 0j, 0.0, *half, sizes, omega, time)
    assert distance == pytest.approx(most + excess)
    assert limit == pytest.approx(most + MARGIN)
    foot, dcm = GAIT.length, later(dcm, half[0], omega, time)
    for _ in range(12):
        dcm = later(dcm, foot, omega, step_time)
        foot += min(GAIT.length, (dcm - foot).real)
    assert ((dcm - foot).real > 1.0) is falls


def test_the_fall_of_a_standing_robot_is_predicted_before_it_reaches_the_ground():
    """A push forward: `test_the_lead_time_of_a_fall_ends_at_the_ground`."""
    simulation, controller, walker = simulated("g1")
    simulation.plant.push(controller.model.base_link, [120.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    simulation.run(1.5)
    assert walker.fall_prediction.sentence == ""
    assert np.abs(simulation.plant.state()[1]).max() < 0.5
    simulation.reset()
    plant = simulation.plant
    plant.push(controller.model.base_link, [0.0, 260.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    with pytest.raises(NoSolution, match="FALLING: a fall is unavoidable: the capture point is"):
        simulation.run(1.5)
    predicted = simulation.time
    for _ in range(500):
        result = controller.step(*plant.state(), plant.time)
        plant.apply(result.tau)
        simulate(plant, plant.steps_per_period)
        if plant.links_on_the_floor():
            break
    assert plant.links_on_the_floor()
    assert plant.time - predicted > 0.2
    assert np.abs(plant.state()[1][6:]).max() < 60.0  # damped


def test_a_fall_while_walking_is_predicted_before_the_base_tilts():
    """`test_a_stepping_robot_survives_a_change_of_its_velocity` has pushes without a prediction."""
    simulation, controller, walker = simulated("g1")
    walker.ask(Velocity())
    simulation.run(2.22)
    simulation.plant.push(controller.model.base_link, [0.0, 400.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    with pytest.raises(NoSolution, match="FALLING"):
        simulation.run(1.2)
    assert walker.fall_prediction.sentence


def test_a_damped_robot_does_not_walk():
    """Its estimate is then checked as that of a standing robot, although the walker was interrupted in a step."""
    simulation, controller, walker = walking("g1", 0.0, seconds=1.0)
    assert controller.is_walking
    controller.supervisor.request("damp", simulation.time, None)
    assert walker.moves
    assert not controller.is_walking


def test_the_lead_time_of_a_fall_ends_at_the_ground(monkeypatch, short_rest):
    trial = EstimationTrial("g1", {**short_rest, "estimation.base_state": "odom"})
    trial.stand()
    with monkeypatch.context() as patch:
        patch.setattr("wbc_controller.validation.accuracy.estimation_trial._FALL_TIME", 0.1)
        assert math.isnan(trial.lead_time())  # it stands
    trial.mock.plant.push(trial.model.base_link, [260.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    with pytest.raises(NoSolution, match="FALLING"):
        trial.run(1.5)
    begun = trial.time
    lead = trial.lead_time()
    assert 0.2 < lead == pytest.approx(trial.time - begun)
    assert trial.mock.plant.links_on_the_floor()
    assert trial.lead_time() == 0.0
