"""Nominal steps, their adaptation to the measured state, and the motion of the swing foot."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.walking.adaptation import FOOT_SPEED, LONGEST, SHORTEST, TIME_RATE, StepTarget, adapted
from wbc_controller.walking.footsteps import Stance, Velocity, nominal_step
from wbc_controller.walking.gait import Gait
from wbc_controller.walking.pendulum import later
from wbc_controller.walking.swing import TOUCHDOWN_SPEED, Axis, Landing, SwingFoot
from wbc_controller.walking.touchdown import LATEST, lands

GAIT = Gait(
    single=0.5, double=0.1, shift=0.8, lowering=0.02, clearance=0.05, width=0.2, least_width=0.14, length=0.45,
    greatest_width=0.55, speed=(0.5, 0.2, 0.5),
)  # fmt: skip
DT = 0.002


def stance(side=1, heading=0.0):
    return Stance(1.0 + 2.0j, heading, side, 3.8)


def test_a_command_is_limited_in_speed_and_acceleration():
    wanted = Velocity(2.0 - 1.0j, -3.0).clipped(GAIT)
    assert wanted == Velocity(0.5 - 0.2j, -0.5)
    assert Velocity().towards(wanted, GAIT, 0.1) == Velocity(pytest.approx(0.03 - 0.03j), pytest.approx(-0.06))
    assert Velocity().towards(wanted, GAIT, 10.0) == wanted
    assert Velocity(-2.0).clipped(GAIT) == Velocity(-0.25)  # backward half of the speed forward


@pytest.mark.parametrize("side", [1, -1])
def test_steps_in_place_keep_the_width(side):
    step = nominal_step(Velocity(), stance(side), GAIT)
    assert step.place == pytest.approx(1.0 + 2.0j + 0.2j * side)
    assert step.heading == 0.0
    assert step.offset.imag * side < 0.0  # the DCM is between the feet


def test_two_steps_move_by_the_velocity():
    velocity = Velocity(0.4 + 0.1j, 0.0)
    left = nominal_step(velocity, stance(1), GAIT)
    right = nominal_step(velocity, Stance(left.place, 0.0, -1, 3.8), GAIT)
    assert right.place - stance().place == pytest.approx(2.0 * GAIT.step_time * velocity.linear)


@pytest.mark.parametrize("sideways", [0.2, -0.2])
def test_sideways_steps_keep_the_feet_apart(sideways):
    for side in (1, -1):
        step = nominal_step(Velocity(sideways * 1j), stance(side), GAIT)
        assert side * (step.place - stance().place).imag >= GAIT.least_width


def test_a_turning_robot_turns_its_feet_and_walks_on_a_circle():
    foot, side = Stance(-0.1j, 0.0, 1, 3.8), 1
    for _ in range(40):
        step = nominal_step(Velocity(0.3, 0.5), foot, GAIT)
        side = -foot.side
        foot = Stance(step.place, step.heading, side, 3.8)
    assert foot.heading == pytest.approx(40 * 0.5 * GAIT.step_time)
    middle = foot.place + 0.5 * GAIT.width * side * complex(-math.sin(foot.heading), math.cos(foot.heading))
    assert abs(middle - 0.6j) == pytest.approx(0.6, rel=0.02)  # radius v / ω


def walked(disturbance, *, elapsed=0.1, cycles=150):
    """Adapt a step after a change of the DCM, for as long as the swing lasts."""
    at, nominal = stance(), nominal_step(Velocity(0.2), stance(), GAIT)
    target = StepTarget(nominal.place, nominal.offset, GAIT.single)
    dcm = later(nominal.place + nominal.offset, at.place, at.omega, elapsed - GAIT.single) + disturbance
    swing, targets = at.place + 0.2j, []
    for _ in range(cycles):
        target = adapted(target, nominal, at, GAIT, dcm, swing, elapsed, DT)
        targets.append(target)
        dcm, elapsed = later(dcm, at.place, at.omega, DT), elapsed + DT
    return nominal, targets


def test_an_undisturbed_step_is_the_nominal_one():
    nominal, targets = walked(0.0)
    assert targets[-1].place == pytest.approx(nominal.place, abs=1e-3)
    assert targets[-1].time == pytest.approx(GAIT.single, abs=2e-3)


@pytest.mark.parametrize("push", [0.03 + 0j, -0.03 + 0j, 0.03j])
def test_a_push_moves_the_step_in_its_direction_and_keeps_the_offset(push):
    nominal, targets = walked(push, cycles=100)
    moved = targets[-1].place - nominal.place
    assert (moved * push.conjugate()).real > 0.0
    assert abs(targets[-1].offset - nominal.offset) < 0.25 * abs(moved)


@given(st.complex_numbers(max_magnitude=0.3, allow_nan=False))
def test_steps_stay_within_reach_and_time(push):
    _, targets = walked(push, cycles=40)
    time = GAIT.single
    for target in targets:
        local = target.place - stance().place
        assert abs(target.time - time) <= TIME_RATE * DT + 1e-12
        assert SHORTEST * GAIT.single <= target.time <= LONGEST * GAIT.single
        time = target.time
        swing = stance().place + 0.2j
        reached = abs(target.place - swing) <= FOOT_SPEED * target.time
        inside = abs(local.real) <= GAIT.length + 1e-9 and -1e-9 <= local.imag <= GAIT.greatest_width + 1e-9
        assert reached
        assert inside


def swung(duration, cycles, change=0j):
    foot = SwingFoot(Axis(0.0), Axis(0.1), Axis(0.0), Axis(0.0))
    landing, feet = Landing(0.3 + 0.12j, 0.01, 0.2), []
    for i in range(cycles):
        if i == cycles // 2:
            landing = Landing(landing.place + change, landing.height, landing.heading)
        foot = foot.moved(landing, GAIT.clearance, i * DT, duration, DT)
        feet.append(foot)
    return feet, landing


@pytest.mark.parametrize("change", [0j, 0.05 - 0.03j])
def test_a_foot_lands_at_its_target_at_rest(change):
    feet, landing = swung(0.5, 250, change)
    last = feet[-1]
    assert last.place == pytest.approx(landing.place, abs=1e-6)
    assert last.heading.position == pytest.approx(landing.heading, abs=1e-6)
    assert last.z.position == pytest.approx(landing.height, abs=1e-6)
    assert last.z.velocity == pytest.approx(-TOUCHDOWN_SPEED, abs=1e-3)
    assert math.hypot(last.x.velocity, last.y.velocity) < 1e-3
    heights = [foot.z.position for foot in feet]
    assert max(heights) == pytest.approx(landing.height + GAIT.clearance, abs=2e-3)


def test_a_swing_is_continuous_when_its_target_changes():
    feet, _ = swung(0.5, 250, 0.05)
    for before, after in itertools.pairwise(feet):
        for a, b in ((before.x, after.x), (before.y, after.y), (before.z, after.z)):
            assert b.position - a.position == pytest.approx(0.5 * DT * (a.velocity + b.velocity), abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_ground_and_step_time_needs_no_large_acceleration(seed):
    """With a short time to the apex, changes by millimetres and milliseconds threw the foot to the ground."""
    rng, foot = np.random.default_rng(seed), SwingFoot(*(Axis(0.0) for _ in range(4)))
    duration, accelerations = 0.5, []
    for i in range(225):  # until the target is frozen, 0.05 s before touchdown
        duration += DT * rng.uniform(-1.0, 1.0)
        landing = Landing(0.3 + 0.12j, 0.001 * rng.standard_normal(), 0.0)
        foot = foot.moved(landing, GAIT.clearance, i * DT, duration, DT)
        accelerations.append(foot.z.acceleration)
    assert max(map(abs, accelerations)) < 20.0  # 9 m/s² without noise


def test_a_late_foot_moves_further_down():
    feet, landing = swung(0.1, 100)
    late = feet[-1].z
    assert late.velocity == -TOUCHDOWN_SPEED
    assert late.position == pytest.approx(landing.height - TOUCHDOWN_SPEED * (100 * DT - 0.1), abs=1e-3)
    assert feet[-1].x.velocity == 0.0


@pytest.mark.parametrize(
    ("share", "late", "wanted", "velocity", "force", "landed"),
    [
        (0.5, -0.2, -0.3, [0.0, 0.1, 0.0], 500.0, False),  # too early to count
        (0.8, -0.1, -0.1, [0.0, 0.1, -0.1], None, False),
        (0.9, -0.05, -0.1, [0.0, 0.1, -0.02], None, True),  # the ground is higher than planned
        (0.8, -0.1, -0.3, [0.0, 0.1, -0.25], None, False),
        (1.0, 0.0, -0.1, [0.0, 0.1, -0.1], None, False),  # the ground is lower than planned
        (1.0, 0.0, -0.1, [0.0, 0.1, -0.04], None, True),
        (0.9, -0.05, -0.1, [1.0, 0.0, -0.04], None, False),  # still swinging
        (0.9, -0.05, -0.4, [0.3, 0.0, 0.2], None, True),  # rebounding
        (1.2, LATEST, -0.1, [0.0, 0.1, -0.1], None, True),
        (0.9, -0.05, -0.1, [0.0, 0.1, 0.0], 5.0, False),  # a measured force counts alone
        (0.9, -0.05, -0.1, [0.0, 0.1, -0.1], 50.0, True),
    ],
)
def test_a_touchdown_is_told_by_force_or_motion(share, late, wanted, velocity, force, landed):
    assert lands(share, late, wanted, np.array(velocity), force) is landed
