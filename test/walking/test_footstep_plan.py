"""Planned footsteps: sides, refusals, offsets of the DCM, and a robot that steps on them."""

import cmath

import numpy as np
import pytest
from gaits import GAIT, run_to, simulated
from refusals import input_refusal

from wbc_controller.walking.footsteps import Stance, Velocity, nominal_step, planned, step_towards
from wbc_controller.walking.gait import Phase
from wbc_controller.walking.pendulum_kernels import periodic_offset, previous_offset

FEET = {1: (0.1j, 0.0), -1: (-0.1j, 0.0)}
OMEGA = 3.8


def test_offsets_of_equal_steps_are_those_of_a_velocity_and_a_periodic_gait():
    for side in (1.0, -1.0):
        b = periodic_offset(0.3, 0.2j * side, OMEGA, 0.5, 0.1, 0.07)
        after = periodic_offset(0.3, -0.2j * side, OMEGA, 0.5, 0.1, 0.07)
        assert previous_offset(after, 0.3 + 0.2j * side, 0.3 - 0.2j * side, OMEGA, 0.5, 0.1, 0.07) == pytest.approx(b)
    stance, velocity = Stance(-0.1j, 0.0, 1, OMEGA), Velocity(0.3)
    wanted = nominal_step(velocity, stance, GAIT, GAIT.single)
    progress = 0.3 * GAIT.step_time
    poses = np.array([[progress * i, 0.1 if i % 2 else -0.1, 0.0] for i in range(1, 9)])
    step = step_towards(planned(poses, FEET, 1, GAIT), stance, GAIT)
    assert step.place == pytest.approx(wanted.place)
    assert step.offset == pytest.approx(wanted.offset, abs=1e-3)
    last = step_towards(planned(poses[:1], FEET, 1, GAIT), stance, GAIT)
    assert last.offset.real < wanted.offset.real - 0.01  # the robot slows down


@pytest.mark.parametrize(("y", "sides"), [(0.1, [1, -1, 1]), (-0.1, [-1, 1, -1])])
def test_sides_alternate_from_the_nearer_foot(y, sides):
    steps = planned(np.array([[0.2, y, 0.0], [0.4, -y, 0.1], [0.4, y, 0.1]]), FEET, None, GAIT)
    assert [step.side for step in steps] == sides
    assert (steps[1].place, steps[1].heading) == (0.4 - 1j * y, 0.1)


@pytest.mark.parametrize(
    ("poses", "first", "message"),
    [
        ([[0.6, 0.1, 0.0]], None, "step 1 of 1 (left foot) is 0.600 m ahead and 0.200 m beside the right foot"),
        ([[0.2, 0.1, 0.0], [0.4, 0.05, 0.0]], None, "step 2 of 2 (right foot) is 0.200 m ahead and 0.050 m beside"),
        ([[0.0, 0.6, 0.0]], None, "valid: -0.450 to 0.450 m ahead, 0.140 to 0.550 m beside, -0.5 to 0.5 rad"),
        ([[0.0, 0.1, 0.6]], None, "turned by 0.60 rad"),
        ([[0.2, 0.11, 0.0]], -1, "step 1 of 1 (right foot) is 0.200 m ahead and -0.010 m beside the left foot"),
    ],
)
def test_refused_steps(poses, first, message):
    assert message in input_refusal(planned, np.array(poses), FEET, first, GAIT)


def test_reach_is_measured_in_the_axes_of_the_other_foot():
    turn = cmath.rect(1.0, 2.0)
    place = 3.0 + 1.0j + (0.3 + 0.2j) * turn
    feet = {-1: (3.0 + 1.0j, 2.0), 1: (3.0 + 1.0j + 0.2j * turn, 2.0)}
    (step,) = planned(np.array([[place.real, place.imag, 2.1 - 2.0 * np.pi]]), feet, None, GAIT)
    assert step.side == 1


def test_a_robot_steps_on_the_plan_and_stops():
    simulation, controller, walker = simulated("g1")
    feet = {foot.contact: foot for foot in walker._feet.values()}
    poses = [[0.15, 0.1, 0.0], [0.35, -0.12, 0.1], [0.35, 0.1, 0.2], [0.5, -0.12, 0.2]]
    middle = 0.5 * sum(foot.pose(controller.dynamics).translation for foot in feet.values())
    poses = np.array(poses) + [*middle[:2], 0.0]
    controller.walk_footsteps(poses)
    landed, left = [], set()

    def look(_):
        left.add(walker.footsteps_left)
        if walker.steps > len(landed):
            landed.append(feet["left_foot" if len(landed) % 2 == 0 else "right_foot"].sole(controller.dynamics))

    results = simulation.run(6.0, look)
    assert left == {4, 3, 2, 1, 0}
    assert walker.phase is Phase.STAND
    assert len(landed) in (5, 6)  # and the feet side by side
    for sole, (x, y, heading) in zip(landed, poses, strict=False):
        assert abs(sole.place - complex(x, y)) < 0.03
        assert sole.heading == pytest.approx(heading, abs=0.05)
    assert not any(result.relaxed for result in results)


def test_a_velocity_replaces_the_plan_in_the_air():
    simulation, controller, walker = simulated("g1")
    controller.walk_footsteps([[0.2, 0.1, 0.0], [0.4, -0.1, 0.0], [0.6, 0.1, 0.0]])
    run_to(simulation, Phase.SINGLE, 0.01)
    simulation.run(0.1)
    assert (walker.phase, walker.footsteps_left) == (Phase.SINGLE, 3)
    refusal = input_refusal(walker.follow, np.array([[0.2, 0.1, 0.0]]), controller.dynamics)
    assert "step 1 of 1 (right foot)" in refusal  # the left foot is in the air
    assert walker.footsteps_left == 3
    controller.walk(0.2)
    simulation.run(1.0)
    assert walker.footsteps_left == 0
    assert walker.command == Velocity(0.2)
    assert walker.phase in (Phase.SINGLE, Phase.DOUBLE)
