import numpy as np
import pytest

from wbc_controller.inverse_dynamics.formulation import relaxation
from wbc_controller.settings.contacts import LoopSettings


def built(bench, seed=2):
    g1 = bench("g1")
    state, references, before = g1.random_problem(seed)
    formulation = g1.controller.formulation
    layout = formulation.build(state, references, before)
    return (
        g1,
        layout,
        list(relaxation.relaxations(formulation, layout, references)),
        formulation.effort_bounds(references),
    )


def released(g1, q, v):
    """Return the layout at a state, and the contacts that a solution without braking releases."""
    formulation = g1.controller.formulation
    layout = formulation.build(g1.state(q, v), g1.references())
    return layout, set(
        relaxation.contacts_preventing_stop(formulation, layout, np.zeros(layout.problem.bounds.shape[1]))
    )


def test_torque_rate_is_relaxed_in_effort_limits(bench):
    g1, layout, ((rate,), _), available = built(bench)
    weights = rate.soft.weights * g1.model.effort_limits**2
    np.testing.assert_allclose(weights, weights[0])
    before = np.array(layout.problem.bounds)
    soft = relaxation.soften(layout, [rate])
    np.testing.assert_array_equal(soft.bounds, before[:, rate.places])
    np.testing.assert_array_equal(layout.problem.bounds[:, rate.places], available)
    others = np.setdiff1d(np.arange(before.shape[1]), rate.places)
    np.testing.assert_array_equal(layout.problem.bounds[:, others], before[:, others])


def test_bounds_are_widened_to_the_violation(bench):
    _, layout, (_, every), _ = built(bench)
    before = np.array(layout.problem.bounds)
    relaxation.soften(layout, every)
    value = np.clip(np.zeros(before.shape[1]), *before)
    (motion,) = (group for group in every if group.name == "joint_motion")
    place = motion.places[3]
    value[place] = before[1, place] + 7.0
    assert relaxation.widen(layout, every, value, 0.0) == ("joint_motion",)
    expected = np.array(before)
    expected[1, place] += 7.0
    np.testing.assert_array_equal(layout.problem.bounds, expected)


@pytest.mark.parametrize(
    ("joint", "speed", "given_up"),
    [
        ("left_knee_joint", 9.0, {"left_foot"}),  # needs 350 rad/s² to stop
        ("left_elbow_joint", 9.0, {"left_foot", "right_foot"}),
        ("left_elbow_joint", 0.0, set()),
    ],
)
def test_released_feet_of_legs_and_arms(bench, joint, speed, given_up):
    g1 = bench("g1")
    q, v = g1.rushing(joint, 0.1, speed)
    layout, found = released(g1, q, v)
    loose = {place.contact.name for place in layout.places if np.linalg.norm((place.J @ v)[:3]) > 0.5}
    assert found == given_up | loose
    assert loose <= given_up


@pytest.mark.parametrize(
    ("rushing", "turning", "given_up"),
    [(9.0, 1.0, {"left_foot"}), (9.0, 4.0, {"left_foot", "right_foot"}), (0.0, 4.0, set())],
)
def test_moving_feet_are_released_while_a_joint_cannot_stop(bench, rushing, turning, given_up):
    g1 = bench("g1")
    q, v = g1.rushing("left_knee_joint", 0.1, rushing)
    v[g1.model.v_index[g1.model.joints.index("right_knee_joint")]] = turning  # can stop
    layout, found = released(g1, q, v)
    speed = float(np.linalg.norm((layout.places[1].J @ v)[:3]))
    assert (speed > 0.5) == (turning > 1.0)
    assert speed < 2.0
    assert found == given_up


def test_loops_are_never_released(bench):
    mask = [True, True, True, False, False, False]
    bar = LoopSettings(frame_a="left_rubber_hand", frame_b="right_rubber_hand", mask=mask, stiffness=100.0)
    g1 = bench("g1").rebuilt(loops={"bar": bar})
    q, v = g1.rushing("left_elbow_joint", 0.1, 9.0)
    layout, found = released(g1, q, v)
    (place,) = (place for place in layout.places if place.contact.name == "bar")
    assert np.linalg.norm(place.J @ v) > 1.0
    assert found == {"left_foot", "right_foot"}
    assert relaxation.slipping_contacts(g1.controller.formulation, layout) == ()
