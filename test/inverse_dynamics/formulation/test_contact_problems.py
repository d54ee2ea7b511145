"""Fixed contacts, contacts between links and loops in the quadratic program: binding constraints and conflicts."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conflicts import conflict_at_rest

from wbc_controller.inverse_dynamics.contacts import FixedContact, LoopClosure
from wbc_controller.mechanics import Kinematics, PinnedFrames, constrained_dynamics
from wbc_controller.mechanics import SurfaceContact as Held


def with_contacts(robot, *contacts):
    """Replace the robot's contacts."""
    formulation = robot.controller.formulation
    robot.controller.contacts = formulation.contacts = {contact.name: contact for contact in contacts}
    formulation._layouts.clear()
    robot.controller._solvers.clear()
    return robot


def bolted(robot, **limits):
    """Return a robot with its base on a bolt."""
    bolt = FixedContact("bolt", robot.model, robot.model.base_link, pin.SE3.Identity(), **limits)
    return with_contacts(robot, bolt)


HANDS = ("left_rubber_hand", "right_rubber_hand")
POINT = [True, True, True, False, False, False]


def between_hands(robot):
    """Return the right hand in the frame of the left hand in the stance, (3,) in m."""
    dynamics = robot.controller.dynamics
    dynamics.update(robot.stance, np.zeros(robot.model.nv))
    left, right = (dynamics.placement(robot.model.frame_id(hand, "")) for hand in HANDS)
    return left.actInv(right).translation


def bar_between_hands(robot, place, **options):
    """Return a loop that holds the right hand in the frame of the left hand."""
    return LoopClosure("bar", robot.model, HANDS, (pin.SE3(np.eye(3), place), pin.SE3.Identity()), POINT, **options)


def test_bolt_carries_the_weight(bench):
    robot = bolted(bench("go2"), max_force=1000.0)
    weight = robot.model.mass * robot.model.gravity
    solution = robot.controller.solve(robot.state(), robot.references())
    assert solution.forces["bolt"][2] == pytest.approx(weight, rel=1e-4)
    assert solution.residuals["contact_motion"] < 1e-9
    down = replace(
        robot.references(), external_wrenches={robot.model.base_link: np.array([0, 0, 3.0 * weight, 0, 0, 0])}
    )
    assert robot.controller.solve(robot.state(), down).forces["bolt"][2] == pytest.approx(-2.0 * weight, rel=1e-4)


def test_weak_bolt_is_named_with_its_unit(bench):
    robot = bolted(bench("go2"), max_force=100.0)
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
    robot = bench("g1")
    dynamics, open_by = robot.controller.dynamics, np.array([0.002, -0.001, 0.003])
    bar = bar_between_hands(robot, between_hands(robot) - open_by, stiffness=100.0)
    with_contacts(robot, *robot.controller.contacts.values(), bar)
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
    model, dynamics, middle = robot.model, robot.controller.dynamics, between_hands(robot)
    bar = bar_between_hands(robot, middle)
    grip = FixedContact("grip", model, HANDS[0], pin.SE3.Identity(), max_force=1000.0, max_moment=1000.0)
    feet = list(robot.controller.contacts.values())
    with_contacts(robot, *feet, grip, bar)
    J = np.vstack([contact.jacobian(dynamics) for contact in (*feet, grip, bar)])
    v = np.random.default_rng(2).normal(size=model.nv)
    v = 0.5 * (v - np.linalg.pinv(J) @ (J @ v))  # no velocity of constraints
    state = robot.state(v=v)
    references = replace(robot.references(), contacts=dict.fromkeys([contact.name for contact in (*feet, grip)], 1.0))
    solution = robot.controller.solve(state, references)
    kinematics = Kinematics(model.pinocchio, robot.stance, v)
    constraints = [PinnedFrames(first=HANDS[0], first_offset=middle, second=HANDS[1]), Held(frame=HANDS[0])]
    for foot in feet:
        frame = robot.settings.contacts[foot.name].frame
        placement = kinematics.placement(frame).actInv(foot.placement(dynamics))
        constraints.append(Held(frame=frame, placement=placement))
    force = np.zeros(model.nv)
    force[model.v_index] = solution.tau
    motion = constrained_dynamics(model.pinocchio, robot.stance, v, force, constraints)
    assert np.abs(solution.v_dot).max() > 0.5
    np.testing.assert_allclose(motion.v_dot, solution.v_dot, atol=1e-6 * np.abs(solution.v_dot).max())
    ours = J.T @ np.concatenate([solution.forces[contact.name] for contact in (*feet, grip, bar)])
    np.testing.assert_allclose(motion.constraint_force, ours, atol=1e-6 * np.abs(ours).max())
