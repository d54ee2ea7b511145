"""Fixed contacts, contacts between links and loops in the quadratic program: binding constraints and conflicts."""

from dataclasses import replace

import numpy as np
import pytest
from conflicts import conflict_at_rest
from snapshots import dynamics_at

from wbc_controller.mechanics import Kinematics, PinnedFrames, constrained_dynamics
from wbc_controller.mechanics import SurfaceContact as Held
from wbc_controller.settings.contacts import FixedContact, LoopSettings

HANDS = ("left_rubber_hand", "right_rubber_hand")


def bolted(robot, **limits):
    """Return a robot with its base on a bolt instead of its feet."""
    bolt = FixedContact(type="fixed", frame=robot.model.base_link, **limits)
    return robot.rebuilt(contacts={"bolt": bolt}, walking=None)


def between_hands(robot):
    """Return the right hand in the frame of the left hand in the stance, (3,) in m."""
    dynamics = dynamics_at(robot.model, robot.stance)
    left, right = (dynamics.placement(robot.model.frame_id(hand, "")) for hand in HANDS)
    return left.actInv(right).translation


def bar_between_hands(place, stiffness):
    """Return a loop that holds the right hand at a place in the frame of the left hand."""
    (first, second), mask = HANDS, [True, True, True, False, False, False]
    bar = LoopSettings(frame_a=first, frame_b=second, translation_a=list(place), mask=mask, stiffness=stiffness)
    return {"bar": bar}


def test_bolt_carries_the_weight(bench):
    robot = bolted(bench("go2"), max_force=1000.0, max_moment=1000.0)
    weight = robot.model.mass * robot.model.gravity
    solution = robot.controller.solve(robot.state(), robot.references())
    assert solution.forces["bolt"][2] == pytest.approx(weight, rel=1e-4)
    assert solution.residuals["contact_motion"] < 1e-9
    up = {robot.model.base_link: np.array([0, 0, 3.0 * weight, 0, 0, 0])}
    lifted = robot.controller.solve(robot.state(), replace(robot.references(), external_wrenches=up))
    assert lifted.forces["bolt"][2] == pytest.approx(-2.0 * weight, rel=1e-4)


def test_weak_bolt_is_named_with_its_unit(bench):
    robot = bolted(bench("go2"), max_force=100.0, max_moment=1000.0)
    weight = robot.model.mass * robot.model.gravity
    why, *_ = conflict_at_rest(robot)
    assert set(why.conflict) == {"force:bolt"}
    assert why.slack["force:bolt"] == pytest.approx(weight - 100.0, rel=1e-3)
    assert why.units["force:bolt"] == "N"
    assert why.sentence.startswith("conflict: force of bolt (at most 100 N, ")
    robot = bolted(bench("go2"), max_force=1000.0, max_moment=20.0)
    twist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 50.0])
    why, *_ = conflict_at_rest(robot, replace(robot.references(), external_wrenches={robot.model.base_link: twist}))
    assert set(why.conflict) == {"moment:bolt"}
    assert why.units["moment:bolt"] == "N·m"
    assert "moment of bolt (at least -20 N·m, " in why.sentence


def test_loops_are_always_active(bench):
    robot, open_by = bench("g1"), np.array([0.002, -0.001, 0.003])
    robot = robot.rebuilt(loops=bar_between_hands(between_hands(robot) - open_by, 100.0))
    bar, dynamics = robot.controller.contacts["bar"], robot.controller.dynamics
    for state in (robot.state(), robot.near_stance(np.random.default_rng(1), position=0.0)):
        references = robot.references(state)
        references = replace(references, contacts=dict.fromkeys(robot.settings.contacts, 1.0))  # without the loop
        solution = robot.controller.solve(state, references)
        assert not solution.relaxed
        J = bar.jacobian(dynamics)
        expected = -100.0 * open_by - 20.0 * J @ state.v - bar.drift(dynamics)
        np.testing.assert_allclose(J @ solution.v_dot, expected, atol=1e-7)
    falling = replace(robot.references(), contacts={})
    assert set(robot.controller.solve(robot.state(), falling).forces) == {"bar"}


def test_solution_with_loop_and_grip_satisfies_gauss_principle(bench):
    """With the torques of the solution, Gauss's principle gives the same motion (S10)."""
    robot = bench("g1")
    model, feet, middle = robot.model, robot.settings.contacts, between_hands(robot)
    grip = FixedContact(type="fixed", frame=HANDS[0], max_force=1000.0, max_moment=1000.0)
    robot = robot.rebuilt(contacts={**feet, "grip": grip}, loops=bar_between_hands(middle, 0.0))
    contacts, dynamics = robot.controller.contacts, dynamics_at(model, robot.stance)
    J = np.vstack([contact.jacobian(dynamics) for contact in contacts.values()])
    v = np.random.default_rng(2).normal(size=model.nv)
    v = 0.5 * (v - np.linalg.pinv(J) @ (J @ v))  # no velocity of constraints
    state = robot.state(v=v)
    solution = robot.controller.solve(state, robot.references())
    kinematics = Kinematics(model.pinocchio, robot.stance, v)
    constraints = [PinnedFrames(first=HANDS[0], first_offset=middle, second=HANDS[1]), Held(frame=HANDS[0])]
    for name, foot in feet.items():
        placement = kinematics.placement(foot.frame).actInv(contacts[name].placement(dynamics))
        constraints.append(Held(frame=foot.frame, placement=placement))
    force = np.zeros(model.nv)
    force[model.v_index] = solution.tau
    motion = constrained_dynamics(model.pinocchio, robot.stance, v, force, constraints)
    assert np.abs(solution.v_dot).max() > 0.5
    np.testing.assert_allclose(motion.v_dot, solution.v_dot, atol=1e-6 * np.abs(solution.v_dot).max())
    ours = J.T @ np.concatenate([solution.forces[name] for name in contacts])
    np.testing.assert_allclose(motion.constraint_force, ours, atol=1e-6 * np.abs(ours).max())
