import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.inverse_dynamics.contacts import LoopClosure
from wbc_controller.inverse_dynamics.formulation.relaxation import (
    contacts_preventing_stop,
    relaxations,
    slipping_contacts,
    soften,
    widen,
)


def built(bench, seed=2):
    g1 = bench("g1")
    state, references, before = g1.random_problem(seed)
    formulation = g1.controller.formulation
    layout = formulation.build(state, references, before)
    return g1, layout, list(relaxations(formulation, layout, references)), formulation.effort_bounds(references)


def rushing(g1, joint):
    """Return q and v of the stance with a joint that cannot stop at its limit."""
    q, v = np.array(g1.stance), np.zeros(g1.model.nv)
    if joint:
        i = g1.model.joints.index(joint)
        q[g1.model.q_index[i]] = g1.model.position_upper[i] - 0.1
        v[g1.model.v_index[i]] = 9.0  # needs 350 rad/s² to stop
    return q, v


def released(g1, q, v):
    """Return the layout at a state, and the contacts that a solution without braking releases."""
    formulation = g1.controller.formulation
    layout = formulation.build(g1.state(q, v), g1.references())
    return layout, set(contacts_preventing_stop(formulation, layout, np.zeros(layout.problem.bounds.shape[1])))


def test_torque_rate_is_relaxed_in_effort_limits(bench):
    g1, layout, ((rate,), _), available = built(bench)
    weights = rate.soft.weights * g1.model.effort_limits**2
    np.testing.assert_allclose(weights, weights[0])
    before = np.array(layout.problem.bounds)
    soft = soften(layout, [rate])
    np.testing.assert_array_equal(soft.bounds, before[:, rate.places])
    np.testing.assert_array_equal(layout.problem.bounds[:, rate.places], available)
    others = np.setdiff1d(np.arange(before.shape[1]), rate.places)
    np.testing.assert_array_equal(layout.problem.bounds[:, others], before[:, others])


def test_bounds_are_widened_to_the_violation(bench):
    _, layout, (_, every), _ = built(bench)
    before = np.array(layout.problem.bounds)
    soften(layout, every)
    value = np.clip(np.zeros(before.shape[1]), *before)
    (motion,) = (group for group in every if group.name == "joint_motion")
    place = motion.places[3]
    value[place] = before[1, place] + 7.0
    assert widen(layout, every, value, 0.0) == ("joint_motion",)
    expected = np.array(before)
    expected[1, place] += 7.0
    np.testing.assert_array_equal(layout.problem.bounds, expected)


@pytest.mark.parametrize(
    ("joint", "given_up"),
    [("left_knee_joint", {"left_foot"}), ("left_elbow_joint", {"left_foot", "right_foot"}), ("", set())],
)
def test_released_feet_of_legs_and_arms(bench, joint, given_up):
    g1 = bench("g1")
    q, v = rushing(g1, joint)
    layout, found = released(g1, q, v)
    loose = {place.contact.name for place in layout.places if np.linalg.norm((place.J @ v)[:3]) > 0.5}
    assert found == given_up | loose
    assert loose <= given_up


@pytest.mark.parametrize(("turning", "given_up"), [(1.0, {"left_foot"}), (4.0, {"left_foot", "right_foot"})])
def test_moving_feet_are_released(bench, turning, given_up):
    g1 = bench("g1")
    q, v = rushing(g1, "left_knee_joint")
    v[g1.model.v_index[g1.model.joints.index("right_knee_joint")]] = turning  # can stop
    layout, found = released(g1, q, v)
    speed = float(np.linalg.norm((layout.places[1].J @ v)[:3]))
    assert (speed > 0.5) == ("right_foot" in given_up)
    assert speed < 2.0
    assert found == given_up


def test_loops_are_never_released(bench):
    g1 = bench("g1")
    hands = ("left_rubber_hand", "right_rubber_hand")
    held = [True, True, True, False, False, False]
    bar = LoopClosure("bar", g1.model, hands, (pin.SE3.Identity(), pin.SE3.Identity()), held, stiffness=100.0)
    formulation = g1.controller.formulation
    formulation.contacts = {**formulation.contacts, "bar": bar}
    formulation._layouts.clear()
    q, v = rushing(g1, "left_elbow_joint")
    layout, found = released(g1, q, v)
    (place,) = (place for place in layout.places if place.contact is bar)
    assert np.linalg.norm(place.J @ v) > 1.0
    assert found == {"left_foot", "right_foot"}
    assert slipping_contacts(formulation, layout) == ()
