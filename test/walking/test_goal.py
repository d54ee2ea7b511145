"""Walking to a pose: velocities towards it, and a robot that stops there."""

import cmath
import math

import numpy as np
import pytest
from gaits import GAIT, simulated

import wbc_controller as wbc
from wbc_controller.walking.footsteps import NEAR, NEAR_ANGLE, Goal, Stance, Velocity, nominal_step, velocity_to
from wbc_controller.walking.gait import Phase


def walked(goal, steps=100):
    """Step towards a goal from the origin; return place, heading and velocity before each step, as of the walker."""
    stance, velocity, history = Stance(-0.1j, 0.0, 1, 3.8), Velocity(), []
    for _ in range(steps):
        middle = stance.place + 0.5j * GAIT.width * stance.side * cmath.rect(1.0, stance.heading)
        wanted = velocity_to(goal, middle, stance.heading, GAIT, GAIT.step_time)
        velocity = velocity.towards(wanted or Velocity(), GAIT, GAIT.step_time)
        history.append((middle, stance.heading, velocity))
        if wanted is None and abs(velocity.linear) < 0.02 and abs(velocity.turning) < 0.02:
            break
        step = nominal_step(velocity, stance, GAIT, GAIT.single)
        stance = Stance(step.place, step.heading, -stance.side, stance.omega)
    return history


@pytest.mark.parametrize(
    ("place", "heading"),
    [(3.0, 0.0), (2.0 - 1.5j, 2.0), (-2.0 + 0.5j, 0.0), (0.3j, 0.0), (-0.4, 0.0), (0.0, math.pi), (0.05 + 0.02j, -0.1)],
)
def test_steps_end_at_the_goal(place, heading):
    goal = Goal(complex(place), heading)
    history = walked(goal)
    assert len(history) < 60
    place, heading, _ = history[-1]
    assert abs(place - goal.place) < 0.06
    assert abs(math.remainder(heading - goal.heading, math.tau)) < 0.1


def test_a_straight_way_has_no_overshoot_and_a_far_goal_is_faced():
    history = walked(Goal(3.0 + 0j, 0.0))
    assert max(place.real for place, _, _ in history) < 3.0 + NEAR
    assert max(velocity.linear.real for _, _, velocity in history) == pytest.approx(0.5)
    assert all(abs(place.imag) < 1e-9 for place, _, _ in history)
    history = walked(Goal(5.0j, 0.0))
    assert max(heading for _, heading, _ in history) > 1.2
    assert history[-1][1] == pytest.approx(0.0, abs=0.1)
    assert velocity_to(Goal(1.0 + 1.0j, 0.3), 1.0 + 1.02j, 0.3 + 2.0 * math.pi, GAIT, GAIT.step_time) is None
    turned = velocity_to(Goal(1.0 + 1.0j, 0.3), 1.0 + 1.0j, 0.3 - 2.0 * NEAR_ANGLE, GAIT, GAIT.step_time)
    assert turned.linear == 0.0
    assert turned.turning > 0.0


def test_a_robot_stops_at_the_goal():
    simulation, controller, walker = simulated("g1")
    controller.walk_to(0.3, 0.1, 0.2)
    results = simulation.run(6.5)
    assert walker.phase is Phase.STAND
    assert walker.goal is None
    q, v = simulation.plant.state()
    assert abs(complex(q[0] - 0.3, q[1] - 0.1)) < 0.1
    assert 2.0 * math.atan2(q[5], q[6]) == pytest.approx(0.2, abs=0.1)
    assert np.abs(v).max() < 0.05
    assert not any(result.relaxed for result in results)


def test_a_goal_begins_steps_and_another_command_replaces_it():
    """A goal at the robot and footsteps out of reach begin no step."""
    controller = wbc.Controller("g1")
    q, v, walker = controller.stance(), np.zeros(controller.model.nv), controller.walker
    controller.reset(q, v)
    middle = 0.5 * sum(foot.pose(controller.dynamics).translation for foot in walker._feet.values())
    controller.walk_to(middle[0] + 0.02, middle[1], 0.0)
    controller.step(q, v, 0.002)
    assert (walker.phase, walker.moves) == (Phase.STAND, False)
    controller.walk_footsteps([[2.0, 0.1, 0.0]])
    result = controller.step(q, v, 0.004)
    assert any(sentence.startswith("step 1 of 1 (left foot) is ") for sentence in result.refused)
    assert not walker.moves
    controller.walk_to(1.0, 0.0, 0.0)
    controller.step(q, v, 0.006)
    assert (walker.goal, walker.phase) == (Goal(1.0 + 0j, 0.0), Phase.SHIFT)
    controller.stand()
    controller.step(q, v, 0.008)
    assert (walker.goal, walker.command) == (None, None)
