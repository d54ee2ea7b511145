"""Nominal steps, their adaptation to the measured state, and the motion of the swing foot."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from gaits import GAIT
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers
from wbc_controller.inverse_dynamics.robot.orientation import about_z, rotation_of
from wbc_controller.walking import adaptation_kernels as kernels
from wbc_controller.walking import swing_kernels
from wbc_controller.walking.feet import Foot, Sole
from wbc_controller.walking.footsteps import NominalStep, Stance, Velocity, nominal_step
from wbc_controller.walking.pendulum_kernels import before, later
from wbc_controller.walking.swing_kernels import Landing, at_rest, integrate_foot, moved
from wbc_controller.walking.touchdown import LATEST, SoleTouchdown, lands, rebounds, tips

GAIT = replace(GAIT, braking=4.0)
DT = 0.002
LEVEL = 0j, 0.0, 0j  # place, height and slope of the ground


def stance(side=1, heading=0.0):
    return Stance(1.0 + 2.0j, heading, side, 3.8)


def test_a_command_is_limited_in_speed_and_acceleration_and_a_stop_brakes_faster():
    wanted = Velocity(2.0 - 1.0j, -3.0).clipped(GAIT)
    assert wanted == Velocity(0.5 - 0.2j, -0.5)
    assert Velocity().towards(wanted, GAIT, 0.1) == Velocity(pytest.approx(0.03 - 0.03j), pytest.approx(-0.06))
    assert Velocity().towards(wanted, GAIT, 10.0) == wanted
    assert Velocity(-2.0).clipped(GAIT) == Velocity(-0.25)  # backward half of the speed forward
    assert Velocity(0.5).towards(Velocity(), GAIT, 0.1) == Velocity(pytest.approx(0.38))
    assert Velocity(0.5).towards(Velocity(0.1), GAIT, 0.1) == Velocity(pytest.approx(0.47))


@pytest.mark.parametrize("side", [1, -1])
def test_steps_in_place_keep_the_width(side):
    step = nominal_step(Velocity(), stance(side), GAIT, GAIT.single)
    assert step.place == pytest.approx(1.0 + 2.0j + 0.2j * side)
    assert step.heading == 0.0
    assert step.offset.imag * side < 0.0  # the DCM is between the feet


def test_steps_move_by_the_velocity():
    step = nominal_step(Velocity(0.4), stance(1), GAIT, 0.3)
    assert (step.place - stance().place).real == pytest.approx(0.4 * (0.3 + GAIT.double))
    velocity = Velocity(0.4 + 0.1j, 0.0)
    left = nominal_step(velocity, stance(1), GAIT, GAIT.single)
    right = nominal_step(velocity, Stance(left.place, 0.0, -1, 3.8), GAIT, GAIT.single)
    assert right.place - stance().place == pytest.approx(2.0 * GAIT.step_time * velocity.linear)


@pytest.mark.parametrize("sideways", [0.2, -0.2])
def test_sideways_steps_keep_the_feet_apart(sideways):
    for side in (1, -1):
        step = nominal_step(Velocity(sideways * 1j), stance(side), GAIT, GAIT.single)
        assert side * (step.place - stance().place).imag >= GAIT.least_width


def test_a_turning_robot_turns_its_feet_and_walks_on_a_circle():
    foot, side = Stance(-0.1j, 0.0, 1, 3.8), 1
    for _ in range(40):
        step = nominal_step(Velocity(0.3, 0.5), foot, GAIT, GAIT.single)
        side = -foot.side
        foot = Stance(step.place, step.heading, side, 3.8)
    assert foot.heading == pytest.approx(40 * 0.5 * GAIT.step_time)
    middle = foot.place + 0.5 * GAIT.width * side * complex(-math.sin(foot.heading), math.cos(foot.heading))
    assert abs(middle - 0.6j) == pytest.approx(0.6, rel=0.02)  # radius v / ω


def adapted(at, nominal, swing, dcm, elapsed, *, planned=False, velocity=0.2, last=None, ground=LEVEL):
    """Return place, height, heading and time of a landing; `last` is that of the last cycle, by default nominal."""
    place, time = (last.place, last.time) if last else (nominal.place, GAIT.single)
    *_, place, height, heading, time, _ = kernels.adapt(
        planned, nominal.place, nominal.heading, nominal.offset, velocity, 0.0, place, time, at.place, at.heading,
        at.side, at.omega, GAIT.sizes, dcm, swing, *ground, elapsed, DT, kernels.SHORTEST * GAIT.single,
    )  # fmt: skip
    return place, height, heading, time


def walked(disturbance, *, elapsed=0.1, cycles=150, planned=True):
    """Adapt a step after a change of the DCM, for as long as the swing lasts.

    Return the nominal step, each landing with the foot's motion before it, and the last offset.
    """
    at, nominal = stance(), nominal_step(Velocity(0.2), stance(), GAIT, GAIT.single)
    landing, landings = Landing(nominal.place, 0.0, 0.0, GAIT.single), []
    swing, share = at_rest(1.0 + 2.2j, 0.0, 0.0), GAIT.reaction / at.omega

    def push():
        return share * integrate_foot(swing, landing.place, landing.time - elapsed, at.omega)

    dcm = before(nominal.place + nominal.offset, at.place, at.omega, GAIT.single - elapsed, push()) + disturbance
    for _ in range(cycles):
        place, _, _, time = adapted(at, nominal, swing, dcm, elapsed, planned=planned, last=landing)
        landing = Landing(place, 0.0, 0.0, time)
        landings.append((landing, swing, elapsed))
        swing = moved(swing, landing, GAIT.clearance, elapsed, DT)
        dcm = later(dcm, at.place, at.omega, DT) + share * complex(*swing[2, :2]) * DT
        elapsed += DT
    return nominal, landings, later(dcm, at.place, at.omega, time - elapsed) + push() - place


def test_undisturbed_and_pushed_steps():
    """Pushed to the outside, a foot lands as early as it can, nearest to the stance foot."""
    nominal, targets, _ = walked(0.0)
    assert targets[-1][0].place == pytest.approx(nominal.place, abs=1e-3)
    assert targets[-1][0].time == pytest.approx(GAIT.single, abs=2e-3)
    _, landings, _ = walked(-0.12j, cycles=20)
    assert landings[-1][0].time < 0.3
    assert landings[-1][0].place.imag == pytest.approx(2.0 + GAIT.least_width)


@pytest.mark.parametrize(("ahead", "passes"), [(0.04, False), (0.08, False), (0.12, True), (0.18, True), (-0.2, True)])
def test_a_foot_pushed_outwards_passes_the_stance_foot_without_touching_it(ahead, passes):
    """Ahead of or behind the stance foot, the feet may be on one line."""
    _, landings, _ = walked(ahead - 0.12j, cycles=40)
    places = [landing.place - stance().place for landing, _, _ in landings]
    assert all(abs(place.real) > GAIT.sole_length or place.imag > GAIT.least_width - 1e-9 for place in places)
    assert (places[-1].imag < 0.5 * GAIT.least_width) is passes
    assert min(place.imag for place in places) >= 0.0
    for place, (_, foot, _) in zip(places, landings, strict=True):
        present = complex(*foot[0, :2]) - stance().place
        way = present + np.linspace(0.0, 1.0, 50) * (place - present)
        assert np.all((abs(way.real) > GAIT.sole_length) | (way.imag > GAIT.sole_width))


@pytest.mark.parametrize("push", [0.03 + 0j, -0.03 + 0j, 0.03j])
def test_a_push_moves_the_step_in_its_direction_and_keeps_the_offset(push):
    nominal, targets, offset = walked(push, cycles=100)
    moved = targets[-1][0].place - nominal.place
    assert (moved * push.conjugate()).real > 0.0
    assert abs(offset - nominal.offset) < 0.25 * abs(moved)


@given(st.complex_numbers(max_magnitude=0.3, allow_nan=False))
def test_steps_stay_within_reach_and_time(push):
    _, targets, _ = walked(push, cycles=40, planned=False)
    time = GAIT.single
    for target, foot, elapsed in targets:
        local = target.place - stance().place
        assert abs(target.time - time) <= kernels.SHORTENING * DT + 1e-12
        assert kernels.SHORTEST * GAIT.single <= target.time <= kernels.LONGEST * GAIT.single
        time = target.time
        present = complex(*foot[0, :2])
        aside = max(local.imag - GAIT.width, 0.0) / (GAIT.greatest_width - GAIT.width)
        assert abs(target.place - present) <= kernels.FOOT_SPEED * (target.time - elapsed) + 1e-9
        assert math.hypot(local.real / GAIT.length, aside) <= 1.0 + 1e-9
        assert local.imag >= -1e-9
        assert target.time - elapsed >= kernels.stopping_time(math.hypot(*foot[1, :2])) - 1e-9


@pytest.mark.parametrize(
    ("beside", "ahead", "rate"),
    [(0.6, 0.0, kernels.TIME_RATE), (0.8, 0.0, kernels.SHORTENING), (0.6, 0.8, kernels.SHORTENING)],
)
def test_a_step_is_hurried_only_if_the_dcm_is_not_above_the_sole(beside, ahead, rate):
    at = stance()
    dcm = at.place + 0.5 * complex(ahead * GAIT.sole_length, -at.side * beside * GAIT.sole_width)
    nominal, swing = nominal_step(Velocity(), at, GAIT, GAIT.single), at_rest(at.place + 1j * GAIT.width, 0.0, 0.0)
    *_, time = adapted(at, nominal, swing, dcm, 0.05, velocity=0j)
    assert time == pytest.approx(GAIT.single - rate * DT)


def test_a_planned_step_ends_at_its_place():
    """Longest and widest at once, which is too far for a step that answers a push."""
    at, corner = stance(), stance().place + complex(GAIT.length, GAIT.greatest_width)
    swing = at_rest(corner - 0.1, 0.0, 0.0)
    dcm = kernels.dcm_towards(corner, -0.1j, at.place, at.omega, GAIT.reaction, swing, 0.3)
    place, *_ = adapted(at, NominalStep(corner, 0.0, -0.1j), swing, dcm, GAIT.single - 0.3, planned=True)
    assert place == pytest.approx(corner)


def test_a_touchdown_is_on_the_ground_with_the_nearest_heading():
    """The foot has turned by more than one turn, and the ground rises by 0.1 m per metre to the left."""
    at = stance(heading=0.3)
    nominal, foot = nominal_step(Velocity(0.2), at, GAIT, GAIT.single), at_rest(at.place, 0.0, 0.2 + 2.0 * math.tau)
    place, height, heading, _ = adapted(at, nominal, foot, at.place, 0.1, ground=(1j, 0.5, 0.1j))
    assert height == pytest.approx(0.5 + 0.1 * (place.imag - 1.0))
    assert heading == pytest.approx(at.heading + 2.0 * math.tau)


@pytest.mark.parametrize(("side", "heading"), [(1, 0.0), (-1, 0.7)])
def test_a_foot_steps_again_if_the_dcm_has_passed_it_and_is_within_its_reach(side, heading):
    axes, half, omega = cmath.rect(1.0, heading), 0.5 * GAIT.sole_width, stance().omega
    place, landed = 1.0 + 2.0j, 1.0 + 2.0j + 0.2j * side * axes
    shortest = 0.3 * GAIT.single
    farthest = (GAIT.greatest_width + half) * math.exp(-omega * shortest)
    for aside, again in (
        (0.19 + half, False), (0.21 + half, True), (farthest - 0.01, True), (farthest + 0.01, False)
    ):  # fmt: skip
        dcm = place + (0.1 + 1j * side * aside) * axes
        assert kernels.steps_again(dcm, place, heading, landed, heading, side, omega, GAIT.sizes, shortest) is again


def test_the_shortest_stop_brakes_at_the_largest_deceleration():
    time = kernels.stopping_time(3.0)
    moves = [swing_kernels.move_axis(0.0, 3.0, 0.0, 1.5 * time, 0.0, time, t) for t in np.linspace(0.0, time, 101)]
    assert moves[-1] == pytest.approx((1.5 * time, 0.0, 0.0), abs=1e-9)
    assert min(a for _, _, a in moves) == pytest.approx(-kernels.FOOT_BRAKING)


@pytest.mark.parametrize(("height", "speed"), [(0.0, 0.0), (0.05, 0.0), (0.01, 0.4), (0.04, -0.3)])
def test_the_shortest_descent_brakes_as_fast_as_it_accelerates(height, speed):
    time = kernels.descent_time(height, speed)
    falls = 0.5 * (time + speed / kernels.FOOT_ACCELERATION)  # until the speed a (t - t_falls) of the rest is reached
    z, v = height, speed
    for begin, end, a in ((0.0, falls, -kernels.FOOT_ACCELERATION), (falls, time, kernels.FOOT_ACCELERATION)):
        z, v = z + v * (end - begin) + 0.5 * a * (end - begin) ** 2, v + a * (end - begin)
    assert (z, v) == (pytest.approx(0.0, abs=1e-12), pytest.approx(0.0, abs=1e-12))


LANDING = Landing(0.3 + 0.12j, 0.01, 0.2, 0.5)


def swung(landing, cycles, change=0j, clearance=GAIT.clearance, dt=DT):
    """Return the motions of a foot that starts at rest, (cycles, 3, 4), and its landing, changed in the middle."""
    foot, feet = at_rest(0.1j, 0.0, 0.0), []
    for i in range(cycles):
        if i == cycles // 2:
            landing = replace(landing, place=landing.place + change)
        foot = moved(foot, landing, clearance, i * dt, dt)
        feet.append(foot)
    return np.array(feet), landing


@pytest.mark.parametrize("change", [0j, 0.05 - 0.03j])
def test_a_foot_lands_at_its_target_at_rest(change):
    feet, landing = swung(LANDING, 250, change)
    place = landing.place
    assert feet[-1, 0] == pytest.approx([place.real, place.imag, landing.height, landing.heading], abs=1e-6)
    assert feet[-1, 1, :3] == pytest.approx([0.0, 0.0, -swing_kernels.TOUCHDOWN_SPEED], abs=1e-3)
    assert feet[:, 0, 2].max() == pytest.approx(landing.height + GAIT.clearance, abs=2e-3)


def test_a_foot_rises_and_descends_beside_stones_on_rough_ground():
    rough = replace(LANDING, speed=0.3, roughness=1.0)
    feet, _ = swung(rough, 500, clearance=GAIT.rough_clearance, dt=0.001)
    rising = feet[99, 0]
    assert rising[[0, 1, 3]].tolist() == [0.0, 0.1, 0.0]
    assert rising[2] > 0.5 * GAIT.clearance
    assert feet[:, 0, 2].max() == pytest.approx(rough.height + GAIT.rough_clearance, abs=3e-3)
    descending = next(foot for foot in feet[225:] if foot[0, 2] < rough.height + 0.04)
    assert descending[0, :2] == pytest.approx([0.3, 0.12], abs=0.01)
    assert feet[-1, 0] == pytest.approx([0.3, 0.12, 0.01, 0.2], abs=1e-3)
    assert feet[-1, 1, 2] == pytest.approx(-0.3, abs=2e-3)


def test_the_push_of_a_swing_is_the_integral_of_its_acceleration():
    """A foot that starts at rest pushes the DCM forward: its acceleration grows longer than its deceleration."""
    omega, goal, dt = 3.8, LANDING.place, 0.001
    feet = np.array([at_rest(0.1j, 0.0, 0.0), *swung(LANDING, 500, dt=dt)[0]])
    accelerations = 0.5 * (feet[:-1, 2, :2] + feet[1:, 2, :2]) @ [1.0, 1.0j]
    pushes = np.exp(omega * (0.5 - dt * (np.arange(500) + 0.5))) * accelerations * dt
    for begin in (0, 200):
        found = integrate_foot(feet[begin], goal, 0.5 - begin * dt, omega)
        assert found == pytest.approx(pushes[begin:].sum(), rel=1e-3)
    assert integrate_foot(feet[0], goal, 0.5, omega).real > 0.0


def test_a_swing_is_continuous_when_its_target_changes():
    feet, _ = swung(LANDING, 250, 0.05)
    assert np.diff(feet[:, 0], axis=0) == pytest.approx(0.5 * DT * (feet[:-1, 1] + feet[1:, 1]), abs=1e-5)


def test_the_reference_of_the_frame_moves_with_the_sole():
    """Velocity and acceleration are the derivatives of the pose, with a frame off the sole."""
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.04, -0.01, -0.03]))
    foot = Foot("foot", "task", 0, placement, (0.1, 0.05), 0, placement_numbers(placement))

    def reference(time):
        a, b, c = np.array([[0.3, 0.1, 0.2, 0.7], [1.0, -0.5, 0.4, 1.5], [2.0, 1.0, -3.0, -2.0]])
        motion = np.array([a + b * time + c * time**2, b + 2.0 * c * time, 2.0 * c])
        return foot.swung(motion, Landing(0j, 0.0, 0.0, 0.5), 0j, 0j, 0.05, 0.0, 0.0, 0.0)[3]

    now = reference(0.0)
    sole = pin.SE3(about_z(0.7), np.array([0.3, 0.1, 0.2]))
    frame = sole * placement.inverse()
    assert now.position[:3] == pytest.approx(frame.translation)
    assert rotation_of(now.position[3:]) == pytest.approx(frame.rotation)
    for number in (1, 2):  # velocity and acceleration
        rate = 1e6 if number == 2 else 500.0
        before, after = reference(-1e-3).position[:3], reference(1e-3).position[:3]
        change = after - before if number == 1 else after - 2.0 * now.position[:3] + before
        assert (now.velocity, now.acceleration)[number - 1][:3] == pytest.approx(rate * change, abs=1e-3)
    assert now.velocity[3:].tolist() == [0.0, 0.0, 1.5]
    assert now.acceleration[3:].tolist() == [0.0, 0.0, -4.0]


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_ground_and_step_time_needs_no_large_acceleration(seed):
    """With a short time to the apex, changes by millimetres and milliseconds threw the foot to the ground."""
    rng, foot = np.random.default_rng(seed), np.zeros((3, 4))
    duration, accelerations = 0.5, []
    for i in range(225):  # until the target is frozen, 0.05 s before touchdown
        duration += DT * rng.uniform(-1.0, 1.0)
        landing = Landing(0.3 + 0.12j, 0.001 * rng.standard_normal(), 0.0, duration)
        foot = moved(foot, landing, GAIT.clearance, i * DT, DT)
        accelerations.append(foot[2, 2])
    assert max(map(abs, accelerations)) < 20.0  # 9 m/s² without noise


def test_a_late_foot_moves_further_down():
    feet, landing = swung(replace(LANDING, time=0.1), 100)
    height, speed, acceleration = feet[50:, :, 2].T
    assert speed[-1] == -swing_kernels.LATE_SPEED
    assert height[-1] < landing.height - 0.02
    assert all(np.diff(speed) <= 0.0)
    assert height[-1] - height[0] == pytest.approx(DT * sum(speed[1:]), abs=1e-9)
    assert acceleration[1:] == pytest.approx(np.where(speed[1:] > -swing_kernels.LATE_SPEED, -10.0, 0.0))
    assert feet[-1, 1, 0] == 0.0


@pytest.mark.parametrize(
    ("late", "wanted", "velocity", "touching", "landed"),
    [
        (-0.1, -0.1, [0.0, 0.1, -0.1], None, False),
        (-0.15, -0.25, [0.0, 0.1, -0.02], None, True),  # the ground is much higher than planned
        (-0.05, -0.1, [0.0, 0.1, -0.02], None, True),  # the ground is higher than planned
        (-0.1, -0.3, [0.0, 0.1, -0.25], None, False),
        (0.0, -0.1, [0.0, 0.1, -0.1], None, False),  # the ground is lower than planned
        (0.0, -0.1, [0.0, 0.1, -0.04], None, True),
        (0.02, -0.3, [0.0, 0.0, -0.1], None, False),  # late; the foot falls behind its reference
        (-0.05, -0.1, [1.0, 0.0, -0.04], None, False),  # still swinging
        (-0.01, -0.2, [-0.2, 2.7, 0.1], None, False),  # a sole that follows a short step late
        (LATEST, -0.1, [0.0, 0.1, -0.1], None, True),
        (-0.05, -0.1, [0.0, 0.1, -0.1], False, False),
        (-0.05, -0.1, [0.0, 0.1, 0.0], False, True),  # too light a touch for the sensor
        (-0.05, -0.1, [0.0, 0.1, -0.1], True, True),
    ],
)
def test_a_touchdown_is_told_by_sensor_or_motion(late, wanted, velocity, touching, landed):
    speed = math.hypot(*velocity)
    assert lands(late, wanted, swing_kernels.TOUCHDOWN_SPEED, velocity[2], speed, touching) is landed


@pytest.mark.parametrize(
    ("elapsed", "horizontal", "speed", "landed"),
    [
        (0.19, 0.1, 0.3, False),  # slower than the planned touchdown, but not stopped
        (0.19, 2.0, 0.9, True),  # the ground has stopped a fast step
        (0.19, 2.0, 1.1, False),
        (0.21, 0.0, 0.9, True),  # a late foot slides
        (0.21, 0.0, 1.1, False),
        (0.11, 2.0, 0.1, False),  # too early
    ],
)
def test_a_sole_of_a_fast_step_has_landed_while_it_slides(elapsed, horizontal, speed, landed):
    swing = np.array([[0.0, 0.0, 0.002, 0.0], [horizontal, 0.0, -0.3, 0.0], [0.0] * 4])
    sole = Sole(place=0j, height=0.001, heading=0.0, slope=0j, rise=0.01, speed=speed, turning=0.0)
    assert SoleTouchdown().update(1.0, elapsed, swing, Landing(0j, 0.0, 0.0, 0.2), 0.05, sole, None) is landed


@pytest.mark.parametrize(("height", "landed"), [(0.009, True), (0.011, False)])
def test_a_sole_rests_only_above_the_expected_ground(height, landed):
    """On rough ground the planned touchdown is 20 mm below the expected ground."""
    swing = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, -0.3, 0.0], [0.0] * 4])
    landing = Landing(0j, -0.02, 0.0, 0.2, speed=0.3, roughness=1.0)
    sole = Sole(place=0j, height=height, heading=0.0, slope=0j, rise=0.0, speed=0.1, turning=0.0)
    detection = SoleTouchdown()
    detection.update(1.0, 0.1, swing, landing, 0.08, sole, None)
    assert detection.update(1.01, 0.19, swing, landing, 0.08, sole, None) is landed
    assert detection.update(1.021, 0.19, swing, landing, 0.08, sole, None)


@pytest.mark.parametrize(
    ("wanted", "rise", "speed", "turning", "tipped"),
    [
        (-0.3, -0.1, 0.3, 2.5, True),  # the ground is much higher than planned; a side of the sole touches it
        (-0.05, -0.1, 0.3, 2.5, False),  # the reference does not descend
        (-0.16, -0.105, 0.13, 1.9, True),  # at the expected height; the centre sinks while the sole turns
        (-0.3, -0.27, 0.3, 2.5, False),  # the foot follows its reference
        (-0.3, -0.1, 0.8, 2.5, False),  # the foot still swings
        (-0.3, -0.1, 0.3, 0.6, False),
        (-0.65, 0.38, 0.39, 3.1, False),  # thrown up by an obstacle
    ],
)
def test_a_sole_on_an_edge_tips(wanted, rise, speed, turning, tipped):
    assert tips(wanted, rise, speed, turning) is tipped


def test_a_point_foot_rebounds_and_a_foot_with_a_fast_touchdown_has_landed_at_half_of_its_speed():
    assert lands(-0.05, -0.3, 0.3, -0.1, 0.1, None)
    assert not lands(-0.05, -0.3, 0.1, -0.1, 0.1, None)
    assert not lands(-0.05, -0.3, 0.3, -0.18, 0.18, None)
    assert rebounds(-0.4, 0.2)
    assert not rebounds(-0.4, -0.01)
    assert not rebounds(-0.05, 0.2)  # the reference does not descend yet
