"""Walking on ground that is not a plane: its estimate from the footholds, and steps onto a small step and a slope."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from gaits import simulated, walking
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.validation.accuracy.walks import WalkTrial, terrain_of
from wbc_controller.walking.feet import Foot
from wbc_controller.walking.gait import Phase
from wbc_controller.walking.swing_kernels import Landing, at_rest
from wbc_controller.walking.terrain import Ground, plane_through
from wbc_controller.walking.walker import Decision

SLOPES = st.complex_numbers(max_magnitude=0.2, allow_nan=False)
PLACES = [0.6 + 0.1j, 0.3 - 0.1j, 0.0 + 0.1j, -0.3 - 0.1j]


@given(SLOPES, st.floats(-1.0, 1.0))
def test_footholds_on_a_plane_give_this_plane(slope, height):
    plane = Ground(0j, height, slope)
    found = plane_through([Ground(place, plane.height_at(place), slope) for place in PLACES])
    assert found.slope == pytest.approx(slope, abs=1e-9)
    assert found.height_at(2.0 - 1.0j) == pytest.approx(plane.height_at(2.0 - 1.0j), abs=1e-9)


def test_planes_of_footholds():
    """One tilted foot is no slope; two on a hill are."""
    plane = Ground(1.0 + 2.0j, 0.3, 0.1 - 0.05j)
    assert plane.height_at(2.0 + 4.0j) == pytest.approx(0.3 + 0.1 * 1.0 - 0.05 * 2.0)
    level = [Ground(place, 0.0, 0j) for place in PLACES]
    assert abs(plane_through([Ground(PLACES[0], 0.01, 0.12 + 0j), *level[1:]]).slope) < 0.06
    hill = Ground(0.15 + 0j, 0.0, 0.09 + 0j)
    on_it = [Ground(place, hill.height_at(place), hill.slope) for place in PLACES[:2]]
    assert plane_through([*on_it, *level[2:]]).slope.real > 0.055


def test_a_swing_sole_turns_to_the_slope_of_the_ground():
    """With a time constant of 0.05 s, and without a change in a cycle of no duration."""
    foot = Foot("foot", "task", 0, pin.SE3.Identity(), (0.1, 0.05), 0, placement_numbers(pin.SE3.Identity()))
    motion, landing, slope, ground = at_rest(0j, 0.0, 0.0), Landing(0j, 0.0, 0.0, 0.5), 0.2 - 0.1j, 0.05 + 0.1j
    assert foot.swung(motion, landing, slope, ground, 0.05, 0.0, 0.0, 0.0)[2] == slope
    for i in range(25):
        motion, _, slope, reference = foot.swung(motion, landing, slope, ground, 0.05, 0.002 * i, 0.002, 0.0)
    assert slope == pytest.approx(ground + (0.15 - 0.2j) * 0.96**25)
    normal = rotation_of(reference.position[3:])[:, 2]
    assert complex(-normal[0] / normal[2], -normal[1] / normal[2]) == pytest.approx(slope, abs=1e-12)


@given(SLOPES, st.floats(-3.0, 3.0))
def test_a_sole_is_parallel_to_the_ground_in_its_heading(slope, heading):
    foot = Foot("foot", "task", 0, pin.SE3.Identity(), (0.1, 0.05), 0, placement_numbers(pin.SE3.Identity()))
    *_, reference = foot.swung(at_rest(0j, 0.0, heading), Landing(0j, 0.0, 0.0, 0.5), slope, 0j, 0.05, 0.0, 0.0, 0.0)
    pose = reference.position
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0)
    rotation = rotation_of(pose[3:])
    normal = rotation[:, 2]
    assert complex(-normal[0] / normal[2], -normal[1] / normal[2]) == pytest.approx(slope, abs=1e-12)
    assert np.arctan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(heading, abs=1e-9)


def heights(simulation):
    """Heights of the true soles, m."""
    return [simulation.plant.foot_placement(name).translation[2] for name in ("left_foot", "right_foot")]


@pytest.mark.parametrize(
    ("block", "height"),
    [
        ({"position": [0.3, 0.0, 0.035], "size": [10.0, 10.0, 0.035]}, 0.035),  # higher than half of the clearance
        ({"position": [0.3, 0.0, 0.0], "size": [10.0, 10.0, 0.2], "rpy": [0.0, -0.087, 0.0]}, None),
        ({"position": [0.0, 0.2, 0.0], "size": [10.0, 20.0, 0.2], "rpy": [0.0, -0.087, 1.5708]}, None),  # across
        ({"position": [-1.0, 0.0, 0.1], "size": [10.0, 4.0, 0.1], "stiffness": 2.0e4}, None),
    ],
    ids=["step", "up", "across", "soft"],
)
def test_a_robot_walks_onto_a_step_and_a_slope_and_on_soft_ground(block, height):
    simulation, controller, walker = simulated("g1", {"mock.terrain": {"ahead": block}})
    controller.walk(0.2, 0.15) if block["position"][1] else controller.walk(0.3)
    highest = []
    results = simulation.run(5.3, lambda now: highest.append(min(heights(now)) * (walker.phase is Phase.DOUBLE)))
    across = block["position"][1] > 0.0  # the first side that touches it turns the sole
    assert sum(bool(result.relaxed) for result in results) <= (5 if across else 0)
    assert not simulation.plant.fallen
    assert walker.steps >= 7
    assert simulation.plant.state()[0][0] > 0.77
    assert max(highest) > 0.015
    if height is not None:
        controller.stand()
        simulation.run(2.8)
        assert walker.phase is Phase.STAND
        assert heights(simulation) == pytest.approx([height, height], abs=0.002)


def test_a_foot_lands_with_one_side_on_a_plate():
    """The swing would push the sole until it tips, and the robot would fall."""
    plate = {"position": [0.15, 0.36, 0.04], "size": [2.0, 0.5, 0.04]}  # 4 cm high, from y = 0.11 m
    simulation, controller, walker = simulated("g1", {"mock.terrain": {"plate": plate}})
    highest = []
    controller.walk(0.2)
    simulation.run(3.0, lambda now: highest.append(max(heights(now)) * (walker.phase is Phase.DOUBLE)))
    assert not simulation.plant.fallen
    assert max(highest) > 0.02  # the sole is on the edge of the plate


@pytest.mark.parametrize("speed", [0.02, 0.1])
def test_a_drift_of_the_estimated_height_is_no_slope_and_does_not_change_the_walk(speed):
    """Without compensation, 0.02 m/s incline the footholds by 0.067.

    On a slope, a controller with the DCM of a pendulum above z = 0 walked downhill faster and faster.
    """
    simulation, controller, walker = simulated("g1", {"safety.base_mismatch": 10.0})
    cycle, stiffness = controller.cycle, 9.81 / (walker.gait.height - walker.gait.lowering)  # ω², 1/s²
    slopes, errors = [], []

    def sinking(inputs):
        q = inputs.state.q.copy()
        q[2] -= speed * inputs.now
        slopes.append(0.0 if walker._step is None else abs(walker._step.begun.ground.slope))
        result = cycle(replace(inputs, state=replace(inputs.state, q=q)))
        seen, pressure = walker._latest
        swing = walker._step.acceleration if walker.phase is Phase.SINGLE else 0.0
        place = complex(*seen.dynamics.com[:2])
        expected = stiffness * (place - pressure) + walker.gait.reaction * swing
        errors.append(abs(complex(*walker._references["walking_com"].acceleration[:2]) - expected))
        return result

    controller.cycle = sinking
    controller.walk(0.3)
    simulation.run(6.0)
    assert walker.steps >= 4
    assert max(slopes) < 0.01
    assert max(errors) < 1e-9
    assert simulation.plant.state()[0][0] == pytest.approx(1.47, abs=0.15)  # 1.47 m without, 1.93 m with that pendulum


def test_the_stance_foot_does_not_turn_on_slippery_ground(short_rest, monkeypatch):
    """The yaw moment of the swing leg turned it, as the configured friction 0.7 allows 13 N·m at the corners."""
    trial = WalkTrial("g1", "good", 0, {**terrain_of("slippery", 0), **short_rest})
    assert trial.settings.contacts["left_foot"].friction > trial.settings.mock.friction == 0.4
    walker, measure, errors = trial.controller.walker, trial.meter.update, []

    def record():
        measure()
        plan = walker.plan()
        errors.append(0.0 if plan is None else abs(plan.dcm - plan.wanted_dcm))

    monkeypatch.setattr(trial.meter, "update", record)
    trial.stand()
    trial.walk(2.5, lambda now: np.array([0.3, 0.0, 0.0]))
    assert walker.steps >= 3
    assert trial.meter.figures().slip < 0.002
    assert np.mean(errors) < 0.011  # 0.015 m with a tenth of the weight of the DCM


def test_a_robot_walks_on_uneven_ground(short_rest):
    """Slow feet landed late on lower cells: it fell after 4.9 s."""
    changes = {**terrain_of("uneven", 3), **short_rest, "estimation.base_state": "odom"}
    trial = WalkTrial("g1", "good", 3, changes)
    trial.stand()
    trial.walk(5.3, lambda now: np.array([0.3, 0.0, 0.0]))
    assert trial.mock.plant.state()[0][0] > 1.2
    assert trial.controller.walker._roughness.unevenness > 0.005


def test_the_base_estimator_knows_whether_the_robot_walks(monkeypatch):
    told, update = [], BaseEstimator.update

    def record(self, *arguments, walking=False):
        told.append((trial.controller.is_walking, walking))
        update(self, *arguments, walking=walking)

    monkeypatch.setattr(BaseEstimator, "update", record)
    trial = WalkTrial("g1", "good", 0)
    trial.stand()
    trial.walk(0.5, lambda now: np.array([0.2, 0.0, 0.0]))
    assert {walking for _, walking in told} == {False, True}
    assert all(walks == walking for walks, walking in told)


def test_after_a_foothold_at_an_unexpected_height_the_feet_land_faster():
    simulation, _, walker = walking("g1", 0.0, seconds=1.0)
    speeds = []

    def look(robot):
        if walker.phase is Phase.SINGLE:
            speeds.append((walker.steps, walker._step.landing.speed, walker._step.swing[1, 2]))

    walker._roughness.unevenness = 0.015
    simulation.run(1.8, look)
    last = {step: (planned, -speed) for step, planned, speed in speeds}  # the reference at touchdown
    even, first, *_, late = last.values()
    assert even == pytest.approx([0.1, 0.1], abs=0.02)
    assert first == pytest.approx([0.3, 0.3], abs=0.02)
    assert 0.15 < late[0] < 0.27  # steps on even ground


def test_rough_ground_is_remembered():
    """After an unexpected foothold, the feet rise twice as high, and their touchdown is planned below the ground."""
    simulation, controller, walker = simulated("g1")
    steps = {}

    def look(robot):
        if walker.phase is Phase.SINGLE:
            landing, swing = walker._step.landing, walker._step.swing
            steps.setdefault(walker.steps, []).append((landing.roughness, landing.height, swing[0, 2]))

    controller.walk(0.0)
    simulation.run(1.4, look)
    assert walker._roughness.share == 0.0
    walker._roughness.share = 1.0
    first = walker.steps + 1
    simulation.run(2.0, look)
    for number in range(first + 1, walker.steps):
        roughness, planned, highest = np.max(steps[number], axis=0)
        assert roughness == pytest.approx(0.93 ** (number - first + 1))
        assert planned == pytest.approx(-0.02 * roughness, abs=1e-3)
        assert 0.75 < (highest - planned) / walker.gait.clearance_on(roughness) < 1.05
    assert max(steps) > first + 2
    assert walker.gait.rough_clearance == 2.0 * walker.gait.clearance


@pytest.mark.parametrize(("roughness", "share"), [(0.0, 0.4), (1.0, 0.65)])
def test_steps_on_rough_ground_are_slower(roughness, share):
    """The fastest step of a biped that is pushed outwards."""
    _, _, walker = walking("g1", 0.0, seconds=1.0)
    cycle, walker._roughness.share = walker._latest[0], roughness
    walker._swing(cycle, walker._step.begun.ground)
    outside = replace(cycle, dcm=cycle.dcm - 0.2j * walker._step.begun.stance.side, time=walker._since + 0.002, dt=0.1)
    walker._single(walker._step, outside, Decision([], {}))
    assert walker._step.landing.time == pytest.approx(share * walker.gait.single)


@pytest.mark.parametrize(
    ("rolled", "moved"), [(0.02, 0.0), (0.05, 0.012), (-0.05, -0.012), (0.05j, 0.012j), (1.0, 0.068), (-1.0j, -0.0175j)]
)
def test_the_centre_of_pressure_moves_to_the_raised_side_of_a_rolling_stance_sole(rolled, moved):
    """By 0.6 m per radian beyond 0.03 rad, to the edge of the usable area at most; G1 fell backwards on `cheap`."""
    _, _, walker = walking("g1", 0.0, seconds=1.0)
    cycle, step, (last, *earlier) = walker._latest[0], walker._step, walker._footholds
    sole, pressures = cycle.soles[walker._stance], []
    for change in (0.0, rolled):
        walker._footholds = (replace(last, slope=sole.slope - change), *earlier)
        pressures.append(walker._single(step, replace(cycle, dt=0.0), Decision([], {})))
    assert pressures[1] - pressures[0] == pytest.approx(moved, abs=1e-3)


def test_at_a_touchdown_the_last_foothold_does_not_move_the_centre_of_pressure():
    """It is that of the old stance foot."""
    pressures = []
    for change in (0.0, 1.0):
        _, _, walker = walking("g1", 0.0, seconds=1.0)
        last, *earlier = walker._footholds
        walker._footholds = (replace(last, slope=last.slope + change), *earlier)
        late = replace(walker._latest[0], dt=0.0, time=walker._since + walker._step.landing.time + 0.2)
        pressures.append(walker._single(walker._step, late, Decision([], {})))
        assert walker.phase is Phase.DOUBLE
    assert pressures[0] == pressures[1]


def test_fast_steps_do_not_measure_the_roughness():
    """After a push, a fast foot of G1 landed tilted, 7 mm too high; with high steps on even ground the robot fell."""
    _, _, walker = walking("g1", 0.0, seconds=1.0)
    assert walker.phase is Phase.SINGLE
    step, cycle = walker._step, walker._latest[0]
    height = cycle.soles[-walker._stance].height - 0.01
    for duration, roughness in ((0.6, 0.0), (1.0, 1.0)):
        landing, stance = replace(step.landing, height=height, time=duration * walker.gait.single), walker._stance
        walker._land(replace(step, landing=landing), cycle, 0.0, Decision([], {}))
        assert walker._roughness.share == roughness
        assert walker._roughness.unevenness == pytest.approx(0.01)
        walker._stance = stance
