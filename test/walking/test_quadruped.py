"""Quadrupeds trot and walk by a velocity command; placement of diagonal feet, and the plane of the ground."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from gaits import simulated, velocity_of, walking
from refusals import input_refusal

import wbc_controller as wbc
from wbc_controller.walking.gait import Phase
from wbc_controller.walking.quadruped_kernels import later_on_line, middle_of_pair
from wbc_controller.walking.terrain import Ground

OMEGA = 5.8
FEET = 0.2 + 0.1j, -0.2 - 0.15j
WALK = {"walking.gait": "walk"}


def test_the_dcm_moves_along_the_line_with_the_body_and_across_it_like_a_pendulum():
    a, b = FEET
    start, velocity, time, n = 0.03 - 0.08j, 0.6 + 0.2j, 0.2, 20_000
    dcm, along = start, (b - a) / abs(b - a)
    across = 1j * along
    for _ in range(n):
        dcm += (OMEGA * ((dcm - a) / across).real * across + (velocity / along).real * along) * time / n
    assert later_on_line(start, a, b, velocity, OMEGA, time) == pytest.approx(dcm, abs=1e-4)
    results = [later_on_line(0.1j, *feet, 0.5, OMEGA, 0.1) for feet in (FEET, FEET[::-1])]
    assert results[0] == pytest.approx(results[1])


def test_a_pendulum_repeats_the_step_and_a_faster_body_steps_further():
    velocity, duration = 0.7 - 0.2j, 0.25
    place = middle_of_pair(0.0, velocity, OMEGA, duration)
    end = place + (0.0 - place) * math.exp(OMEGA * duration)
    assert middle_of_pair(end, velocity, OMEGA, duration) - place == pytest.approx(velocity * duration)
    places = [middle_of_pair(velocity / OMEGA, 0.5, OMEGA, 0.25).real for velocity in (0.5, 0.6)]
    assert places[1] - places[0] == pytest.approx(0.1 / OMEGA)


def test_the_ground_is_the_plane_of_smallest_squares_below_the_feet():
    places = [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.3, 0.0)]
    points = np.array([(x, y, 0.3 + 0.1 * x - 0.05 * y) for x, y in places])
    assert Ground.below(points).height_at(1.0 + 2.0j) == pytest.approx(0.3 + 0.1 - 0.1)
    points = np.array([(0.2, 0.1, 0.01), (0.2, -0.1, 0.0), (-0.2, 0.1, 0.0), (-0.2, -0.1, 0.01)])
    assert Ground.below(points).height_at(0.2 + 0.1j) == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("changes", "command", "together"),
    [({}, (0.8, 0.0, 0.0), 2), ({}, (-0.1, 0.15, 0.6), 2), (WALK, (0.08, 0.0, 0.1), 1)],
)
def test_a_quadruped_walks_in_groups_as_commanded_and_stops_within_three_steps(changes, command, together):
    """A swing beyond `limits.acceleration` would move the base in place of the foot."""
    simulation, controller, walker = simulated("go2", changes)
    controller.walk(*command)
    results = simulation.run(1.7)
    walked = simulation.run(walker.gait.cycle * (2 if changes else 3))
    assert velocity_of(walked) == pytest.approx(np.array(command), abs=0.03)
    steps = walker.steps
    controller.stand()
    results += walked + simulation.run(2.0 if not changes else 3.6)
    assert walker.phase is Phase.STAND
    assert walker.steps - steps <= 3
    assert np.abs(simulation.plant.state()[1]).max() < 0.02
    assert set(results[-1].forces) == set(controller.contacts)
    assert not any(result.relaxed for result in results)
    assert not [name for result in results for name in result.binding if name.startswith("motion")]
    swings = [set(controller.contacts) - set(result.forces) for result in results]
    assert max(map(len, swings)) == together
    opposite = {"front_left_foot": "rear_right_foot", "front_right_foot": "rear_left_foot"}
    for pair in (swing for swing in swings if len(swing) == 2):
        assert any(pair == {front, rear} for front, rear in opposite.items())


def test_a_command_in_several_directions_is_scaled_together():
    changes = {"walking.max_speed": 0.8, "walking.max_side_speed": 0.4}
    velocity = walking("go2", 0.8, 0.4, 1.5, seconds=1.8, changes=changes)[2].velocity
    assert velocity.linear == pytest.approx((0.8 + 0.4j) / math.sqrt(3.0))
    assert velocity.turning == pytest.approx(1.5 / math.sqrt(3.0))


def test_a_quadruped_stops_at_a_goal_and_reports_its_plan():
    simulation, controller, walker = simulated("go2")
    plans = []
    controller.walk_to(0.4, 0.1, 0.3)
    simulation.run(4.6, lambda now: plans.append(walker.plan()))
    assert walker.phase is Phase.STAND
    assert walker.goal is None
    q, _ = simulation.plant.state()
    assert abs(complex(q[0] - 0.4, q[1] - 0.1)) < 0.1
    assert 2.0 * math.atan2(q[5], q[6]) == pytest.approx(0.3, abs=0.1)
    swings = [plan for plan in plans if plan is not None and plan.swings]
    assert {frozenset(plan.swings) for plan in swings} >= {frozenset(group) for group in walker.gait.groups}
    assert all(0.0 <= plan.remaining <= walker.gait.swing for plan in swings)
    assert walker.plan() is None
    assert "only bipeds" in input_refusal(walker.follow, np.zeros((1, 3)), controller.dynamics)


def test_a_jammed_contact_sensor_of_a_quadruped_changes_nothing():
    def torques(touching):
        simulation = wbc.Simulation("go2")
        cycle = simulation.controller.cycle
        simulation.controller.cycle = lambda inputs: cycle(replace(inputs, touching=touching))
        simulation.controller.walk(0.3)
        return [result.tau for result in simulation.run(1.0)]

    jammed = torques(dict.fromkeys(wbc.Controller("go2").contacts, True))
    assert all(np.array_equal(a, b) for a, b in zip(torques({}), jammed, strict=True))


def test_a_trot_starts_in_the_heading_of_its_feet():
    simulation, controller, walker = simulated("go2")
    q, v = simulation.plant.state()
    turn = 2.0
    place = complex(q[0], q[1]) * cmath.rect(1.0, turn)
    q[0], q[1] = place.real, place.imag
    q[3:7] = 0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn)
    controller.reset(q, v)
    controller.walk(0.2)
    controller.step(q, v, 0.0)
    controller.step(q, v, 0.002)
    assert walker._heading == pytest.approx(turn, abs=1e-6)
