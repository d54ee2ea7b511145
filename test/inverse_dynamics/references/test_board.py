import numpy as np
import pinocchio as pin
import pytest
from snapshots import dynamics_at, random_state

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.contacts import PointContact
from wbc_controller.inverse_dynamics.references.board import BoardPlan, ContactPlan, ReferenceBoard, TaskPlan
from wbc_controller.inverse_dynamics.references.changes import (
    EnableContact,
    EnableTask,
    SetExternalWrench,
    SetSetpoint,
    SetSlippingContacts,
    SetTrajectory,
    SetWeight,
)
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.inverse_dynamics.tasks import ComTask, FramePoseTask, PostureTask
from wbc_controller.records import Tuning

START, DURATION, WEIGHT_RAMP, CONTACT_RAMP = 10.0, 1.0, 0.5, 0.2
GOAL = np.array([0.1, -0.2, 0.5])
JUST = 1.0e-7


@pytest.fixture(scope="module")
def dynamics(go2):
    return dynamics_at(go2, *random_state(go2, np.random.default_rng(0)))


@pytest.fixture
def board(go2, dynamics):
    plans = {
        "com": TaskPlan(ComTask("com", [True] * 3), 50.0, True, DURATION),
        "foot": TaskPlan(FramePoseTask("foot", go2, "FL_foot"), 5.0, False, DURATION),
        "posture": TaskPlan(PostureTask("posture", go2), 0.1, True, 0.0),
    }
    foot = PointContact("foot", go2, "FL_foot", np.zeros(3), 0.0)
    contacts = {"left": (True, CONTACT_RAMP), "right": (False, CONTACT_RAMP), "stiff": (True, 0.0)}
    contacts = {name: ContactPlan(*plan, foot) for name, plan in contacts.items()}
    tuning = Tuning({name: plan.task.gains for name, plan in plans.items()}, 0.02, 0.02, 1.0, 200.0, 100.0)
    result = ReferenceBoard(BoardPlan(plans, contacts, WEIGHT_RAMP, tuning))
    result.reset(dynamics, START)
    return result


def still(size, time, position):
    return Knot(time, np.asarray(position), np.zeros(size), np.zeros(size))


def trajectory(task, *times, start=None):
    """Return a trajectory that reaches each time as its position."""
    return SetTrajectory(task, start, tuple(still(3, t, np.full(3, t)) for t in times))


def assert_no_jump(board, task, time, before):
    """Compare the references just before and after a change, in all three parts."""
    after = board.sample(time).tasks[task]
    np.testing.assert_allclose(after.position, before.position, atol=1e-9)
    np.testing.assert_allclose(after.velocity, before.velocity, atol=1e-7)
    np.testing.assert_allclose(after.acceleration, before.acceleration, atol=1e-6)
    later = board.sample(time + JUST).tasks[task]
    np.testing.assert_allclose(later.acceleration, before.acceleration, atol=1e-3)


def test_reset_holds_the_present_state(board, dynamics):
    for time in (START, START + 100.0):
        references = board.sample(time)
        for name, plan in board.plans.items():
            np.testing.assert_array_equal(references.tasks[name].position, plan.task.position(dynamics))
            assert not references.tasks[name].velocity.any()
        assert references.weights == {"com": 50.0, "foot": 0.0, "posture": 0.1}
        assert references.contacts == {"left": 1.0, "right": 0.0, "stiff": 1.0}
        assert not references.external_wrenches


def test_setpoint_is_reached_in_its_duration(board, dynamics):
    before = board.sample(START).tasks["com"]
    board.apply([SetSetpoint("com", GOAL)], dynamics, START)
    assert_no_jump(board, "com", START, before)
    middle = board.sample(START + 0.5 * DURATION).tasks["com"]
    np.testing.assert_allclose(middle.position, 0.5 * (before.position + GOAL), atol=1e-9)
    for time in (START + DURATION, START + 100.0):
        reference = board.sample(time).tasks["com"]
        np.testing.assert_array_equal(reference.position, GOAL)
        assert not reference.velocity.any()
    np.testing.assert_allclose(board.sample(START + DURATION - JUST).tasks["com"].velocity, 0.0, atol=1e-9)


def test_replaced_pose_is_continuous(board, dynamics):
    board.apply([EnableTask("foot", True)], dynamics, START)
    goals = [
        np.concatenate([GOAL, pin.Quaternion(pin.exp3(np.array(turn))).coeffs()])
        for turn in ([1.0, 0.5, -0.3], [-0.4, 0.2, 1.0], [0.3, 0.3, 0.3])
    ]
    for i, goal in enumerate(goals):
        now = START + 0.4 * i
        before = board.sample(now).tasks["foot"]
        board.apply([SetSetpoint("foot", goal)], dynamics, now)
        assert_no_jump(board, "foot", now, before)
    last = board.sample(now + DURATION).tasks["foot"]
    np.testing.assert_array_equal(last.position, goals[-1])


def test_trajectory_joins_the_present_reference(board, dynamics):
    board.apply([SetSetpoint("com", GOAL)], dynamics, START)
    now = START + 0.3
    before = board.sample(now).tasks["com"]
    board.apply([trajectory("com", 1.0, 2.0)], dynamics, now)
    assert_no_jump(board, "com", now, before)
    np.testing.assert_allclose(board.sample(now + 1.0).tasks["com"].position, 1.0)
    np.testing.assert_allclose(board.sample(now + 2.0).tasks["com"].position, 2.0)


@pytest.mark.parametrize(
    ("times", "start", "at", "reached"),
    [
        ((0.5, 1.0), START + 5.0, START + 5.5, 0.5),  # starts later
        ((0.0, 1.0, 2.0), START - 1.5, START + 0.5, 2.0),  # in progress: joined at its next point
        ((0.0, 1.0), None, START + 1.0, 1.0),  # the first point, at the present time, is skipped
        ((0.0,), None, START + DURATION, 0.0),
        ((0.0, 1.0), START + 0.0025, START + 1.0025, 1.0),  # so is a point that is almost due
    ],
)
def test_trajectory_with_any_start_is_joined(board, dynamics, times, start, at, reached):
    before = board.sample(START).tasks["com"]
    board.apply([trajectory("com", *times, start=start)], dynamics, START)
    assert_no_jump(board, "com", START, before)
    np.testing.assert_allclose(board.sample(at).tasks["com"].position, reached, atol=1e-12)
    assert np.abs(board.sample(START + 0.01).tasks["com"].acceleration).max() < 50.0  # m/s²; thousands for a jump


def test_repeated_trajectory_has_no_effect(board, dynamics):
    again = trajectory("com", 0.5, 1.0, 2.0, start=START)
    board.apply([again], dynamics, START)
    times = [START + 1.3, START + 1.35, START + 1.6, START + 1.9]
    expected = [board.sample(time).tasks["com"] for time in times]
    board.apply([again], dynamics, times[0])
    for time, reference in zip(times, expected, strict=True):
        np.testing.assert_allclose(board.sample(time).tasks["com"].position, reference.position, atol=1e-9)
        np.testing.assert_allclose(board.sample(time).tasks["com"].velocity, reference.velocity, atol=1e-8)


def test_past_trajectory_is_refused_with_all_changes(board, dynamics):
    before = board.sample(START)
    changes = [SetWeight("com", 1.0), SetSetpoint("com", GOAL), EnableContact("left", False), EnableTask("foot", True)]
    late = trajectory("com", 1.0, 2.0, start=START - 2.5)
    with pytest.raises(InputRefused, match=r"task 'com' ended 0\.500 s ago"):
        board.apply([*changes, late], dynamics, START)
    after = board.sample(START + 10.0)
    assert after.weights == before.weights
    assert after.contacts == before.contacts
    np.testing.assert_array_equal(after.tasks["com"].position, before.tasks["com"].position)
    board.apply(changes, dynamics, START)  # applied without the refused change
    assert board.sample(START + 10.0).weights["com"] == 1.0


@pytest.fixture
def elsewhere(go2):
    """Return a snapshot after a motion of the robot."""
    return dynamics_at(go2, *random_state(go2, np.random.default_rng(1)))


POSE = np.concatenate([GOAL, pin.Quaternion(pin.exp3(np.array([0.2, -0.3, 0.4]))).coeffs()])
SETPOINT = SetSetpoint("foot", POSE)
ENABLE = EnableTask("foot", True)


def assert_starts_here_and_reaches(board, elsewhere, now, reached):
    here = board.plans["foot"].task.rest(elsewhere)
    assert_no_jump(board, "foot", now, here)
    assert board.sample(now).weights["foot"] == 0.0
    assert board.sample(now + WEIGHT_RAMP).weights["foot"] == 5.0
    end = board.sample(reached).tasks["foot"]
    np.testing.assert_allclose(end.position, POSE, atol=1e-9)
    np.testing.assert_allclose(end.velocity, 0.0, atol=1e-9)


@pytest.mark.parametrize("changes", [(SETPOINT, ENABLE), (ENABLE, SETPOINT)])
@pytest.mark.parametrize("together", [True, False])
def test_enabled_task_starts_at_the_present_state(board, elsewhere, changes, together):
    now = START + 3.0
    for group in [changes] if together else [[change] for change in changes]:
        board.apply(group, elsewhere, now)
    assert_starts_here_and_reaches(board, elsewhere, now, now + DURATION)


def test_setpoint_during_the_ramp_to_zero_is_stored(board, dynamics, elsewhere):
    board.apply([ENABLE], dynamics, START)
    board.apply([EnableTask("foot", False)], dynamics, START + 2.0)
    board.apply([SETPOINT], dynamics, START + 2.0 + 0.5 * WEIGHT_RAMP)
    board.apply([ENABLE], elsewhere, START + 5.0)
    assert_starts_here_and_reaches(board, elsewhere, START + 5.0, START + 5.0 + DURATION)


def test_task_enabled_during_its_ramp_to_zero_continues(board, dynamics):
    board.apply([ENABLE, SETPOINT], dynamics, START)
    board.apply([EnableTask("foot", False)], dynamics, START + 0.6)
    now = START + 0.8
    before = board.sample(now)
    board.apply([ENABLE], dynamics, now)
    assert_no_jump(board, "foot", now, before.tasks["foot"])
    assert board.sample(now).weights["foot"] == pytest.approx(before.weights["foot"])
    assert 0.0 < before.weights["foot"] < 5.0
    np.testing.assert_array_equal(board.sample(START + DURATION).tasks["foot"].position, POSE)


def test_stored_goal_is_used_once(board, dynamics, elsewhere):
    board.apply([SETPOINT], dynamics, START)
    board.apply([ENABLE], dynamics, START)
    board.apply([EnableTask("foot", False)], dynamics, START + 2.0)
    board.apply([ENABLE], elsewhere, START + 5.0)
    here = board.plans["foot"].task.position(elsewhere)
    np.testing.assert_array_equal(board.sample(START + 9.0).tasks["foot"].position, here)


@pytest.mark.parametrize("enabled_after", [0.0, 1.2, 5.0])
def test_trajectory_of_a_disabled_task_is_joined_later(board, dynamics, elsewhere, enabled_after):
    points = tuple(still(6, time, POSE) for time in (1.0, 2.0))
    board.apply([SetTrajectory("foot", None, points)], dynamics, START)
    now = START + enabled_after
    board.apply([ENABLE], elsewhere, now)
    assert_starts_here_and_reaches(board, elsewhere, now, max(START + 2.0, now + DURATION))


def test_reset_discards_goals_wrenches_and_weights(board, dynamics, elsewhere):
    board.apply([SETPOINT, SetExternalWrench("base", np.ones(6)), SetWeight("com", 1.0)], dynamics, START)
    board.reset(elsewhere, START + 1.0)
    references = board.sample(START + 1.0)
    assert not references.external_wrenches
    assert references.weights["com"] == 50.0
    board.apply([ENABLE], elsewhere, START + 1.0)
    here = board.plans["foot"].task.position(elsewhere)
    np.testing.assert_array_equal(board.sample(START + 9.0).tasks["foot"].position, here)


def test_setpoint_without_duration_is_immediate(board, dynamics):
    goal = np.linspace(-1.0, 1.0, 12)
    board.apply([SetSetpoint("posture", goal)], dynamics, START + 1.0)
    reference = board.sample(START + 1.0).tasks["posture"]
    np.testing.assert_array_equal(reference.position, goal)
    assert not reference.velocity.any()
    assert not reference.acceleration.any()


def test_weight_ramps(board, dynamics):
    board.apply([SetWeight("com", 150.0)], dynamics, START)
    weights = [board.sample(START + share * WEIGHT_RAMP).weights["com"] for share in (0.0, 0.25, 1.0, 5.0)]
    quarter = (0.75 * 50.0 ** (1 / 3) + 0.25 * 150.0 ** (1 / 3)) ** 3
    assert weights == pytest.approx([50.0, quarter, 150.0, 150.0])
    board.apply([EnableTask("com", False)], dynamics, START + 1.0)
    board.apply([SetWeight("com", 20.0)], dynamics, START + 1.0 + 0.5 * WEIGHT_RAMP)  # disabled: still on its ramp to 0
    assert board.sample(START + 1.0 + 0.5 * WEIGHT_RAMP).weights["com"] == pytest.approx(150.0 / 8)
    assert board.sample(START + 3.0).weights["com"] == 0.0
    board.apply([EnableTask("com", True)], dynamics, START + 3.0)
    assert board.sample(START + 4.0).weights["com"] == 20.0


def test_contact_activation_ramps(board, dynamics):
    board.apply([EnableContact("left", False), EnableContact("right", True)], dynamics, START)
    half = board.sample(START + 0.5 * CONTACT_RAMP).contacts
    assert half["left"] == pytest.approx(0.125)
    assert half["right"] == pytest.approx(0.125)
    back = START + 0.5 * CONTACT_RAMP
    board.apply([EnableContact("left", True)], dynamics, back)
    assert board.sample(back).contacts["left"] == pytest.approx(0.125)
    assert board.sample(START + 1.0).contacts == {"left": 1.0, "right": 1.0, "stiff": 1.0}
    board.apply([EnableContact("stiff", False)], dynamics, START + 1.0)
    assert board.sample(START + 1.0).contacts["stiff"] == 0.0


@pytest.mark.parametrize(
    ("unloaded", "first", "at_half"),
    [
        # The other foot can carry the weight of 400 N.
        (["left"], {"left": 0.3, "right": 1.0}, {"left": 0.3 / 8, "right": 1.0}),
        # 300 N and 100 N.
        (["left", "right"], {"left": 0.3, "right": 0.2}, {"left": 0.15, "right": 0.1}),
    ],
)
def test_contacts_are_unloaded_from_their_force_and_leave_the_weight(go2, dynamics, unloaded, first, at_half):
    most, forces = {"left": 2000.0, "right": 1000.0}, {"left": [9.0, 0.0, 600.0], "right": [0.0, -9.0, 200.0]}
    plans = {}
    for name, largest in most.items():
        foot = PointContact(name, go2, "FL_foot", np.zeros(3), 0.0, max_normal_force=largest)
        plans[name] = ContactPlan(True, CONTACT_RAMP, foot)
    tuning = Tuning({}, 0.02, 0.02, 1.0, 200.0, 100.0)
    board = ReferenceBoard(BoardPlan({}, plans, WEIGHT_RAMP, tuning, robot_weight=400.0))
    board.reset(dynamics, START)
    board.forces = {name: np.array(force) for name, force in forces.items()}
    board.apply([EnableContact(name, False) for name in unloaded], dynamics, START)
    assert board.sample(START).contacts == pytest.approx(first)
    assert board.sample(START + 0.5 * CONTACT_RAMP).contacts == pytest.approx(at_half)
    samples = [board.sample(START + time).contacts for time in np.arange(0.0, CONTACT_RAMP, 0.002)]
    bounds = [sum(sample[name] * largest for name, largest in most.items()) for sample in samples]
    assert min(bounds) >= 400.0 * (1.0 - 1e-9)
    assert {board.sample(START + CONTACT_RAMP).contacts[name] for name in unloaded} == {0.0}


def test_slipping_contact_has_little_friction_until_it_rests(board, dynamics):
    assert board.sample(START).friction == {"left": 1.0, "right": 1.0, "stiff": 1.0}
    board.apply([SetSlippingContacts(("left",))], dynamics, START)
    assert board.sample(START + 0.01).friction["left"] == pytest.approx((0.5 + 0.5 * 0.05 ** (1 / 3)) ** 3)
    assert board.sample(START + 0.02).friction == {"left": 0.05, "right": 1.0, "stiff": 1.0}
    board.apply([SetSlippingContacts(("left", "stiff"))], dynamics, START + 1.0)
    assert board.sample(START + 1.02).friction == {"left": 0.05, "right": 1.0, "stiff": 0.05}
    board.apply([SetSlippingContacts(())], dynamics, START + 2.0)
    shares = [board.sample(START + time).friction["left"] for time in (2.0, 2.5, 3.5, 4.0)]
    assert shares[0] == 0.05
    assert shares == sorted(shares)
    assert shares[-2] < shares[-1] == 1.0
    board.apply([SetSlippingContacts(("left",))], dynamics, START + 5.0)
    board.reset(dynamics, START + 6.0)
    assert (board.slipping, board.sample(START + 6.0).friction["left"]) == ((), 1.0)


def test_external_wrenches_are_held(board, dynamics):
    wrench = np.arange(6.0)
    board.apply([SetExternalWrench("base", np.ones(6))], dynamics, START)
    board.apply([SetExternalWrench("base", wrench), SetExternalWrench("FL_foot", -wrench)], dynamics, START)
    wrenches = board.sample(START + 50.0).external_wrenches
    assert set(wrenches) == {"base", "FL_foot"}
    np.testing.assert_array_equal(wrenches["base"], wrench)


def relative(board, dynamics, task, position, frame, time=START):
    """Return the target of a setpoint in another frame."""
    board.apply([SetSetpoint(task, np.asarray(position, dtype=float), frame=frame)], dynamics, time)
    return board.sample(time + 100.0).tasks[task].position


def test_relative_setpoints_add_up(board, dynamics):
    start = board.sample(START).tasks["com"].position
    relative(board, dynamics, "com", [0.02, 0.0, 0.0], "com/reference")
    reached = relative(board, dynamics, "com", [0.02, 0.0, -0.01], "com/reference", START + 0.1 * DURATION)
    np.testing.assert_allclose(reached - start, [0.04, 0.0, -0.01], atol=1e-12)
    start = board.sample(START).tasks["posture"].position
    step = np.linspace(-0.1, 0.1, len(start))
    np.testing.assert_allclose(relative(board, dynamics, "posture", step, "posture/reference"), start + step)
    start = board.plans["foot"].task.position(dynamics)
    for _ in range(2):  # while the task is disabled
        relative(board, dynamics, "foot", [0, 0, 0.1, 0, 0, 0, 1], "foot/reference")
    board.apply([ENABLE], dynamics, START)
    np.testing.assert_allclose(board.sample(START + 100.0).tasks["foot"].position[:3], start[:3] + [0, 0, 0.2])


def test_setpoint_in_the_heading_frame(board, dynamics):
    start = board.sample(START).tasks["com"].position
    step = relative(board, dynamics, "com", [0.03, 0.0, 0.01], "com/heading") - start
    ahead = pin.XYZQUATToSE3(dynamics.q[:7]).rotation[:, 0]
    assert step[2] == pytest.approx(0.01)
    np.testing.assert_allclose(step[:2], 0.03 * ahead[:2] / np.linalg.norm(ahead[:2]), atol=1e-12)


def test_setpoints_in_robot_and_reference_frames(board, dynamics):
    board.apply([EnableTask("foot", True)], dynamics, START)
    base = dynamics.placement(dynamics.model.frame_id("base", "frame"))
    at = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.2, 0.0, -0.3]))
    reached = pin.XYZQUATToSE3(relative(board, dynamics, "foot", pin.SE3ToXYZQUAT(at), "base"))
    assert reached.isApprox(base * at, 1e-9)
    turn = pin.exp3(np.array([0.0, 0.0, 0.5]))
    quaternion = pin.Quaternion(turn).coeffs()
    turned = relative(board, dynamics, "foot", [0, 0, 0.1, *quaternion], "foot/reference", START + 200.0)
    np.testing.assert_allclose(turned[:3], reached.translation + [0, 0, 0.1], atol=1e-9)
    np.testing.assert_allclose(pin.XYZQUATToSE3(turned).rotation, turn @ reached.rotation, atol=1e-9)
