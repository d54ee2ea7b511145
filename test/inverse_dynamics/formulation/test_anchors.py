"""Contact anchors: displacement, feedback, and decay."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hand_contacts import HANDS, a_fixed, a_point, a_surface, a_wheel, random_place
from snapshots import dynamics_at, random_state, rate_along

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.references.changes import EnableContact, SetSlippingContacts
from wbc_controller.records import frozen
from wbc_controller.settings import contacts as settings

STIFFNESS, DAMPING = 100.0, 20.0


#: A contact kind, and a twist along its free axes in the contact frame, which keeps it at its anchor.
KINDS = {
    "surface": (a_surface, [0, 0, 0, 0, 0, 0]),
    "point": (a_point, [0, 0, 0, 0, 0, 0]),
    "wheel": (a_wheel, [0, 0, 0, 0, 0, 0]),
    "bolt": (a_fixed([1, 1, 1, 1, 1, 1]), [0, 0, 0, 0, 0, 0]),
    "rail": (a_fixed([1, 0, 1, 1, 0, 1]), [0, 0.4, 0, 0, 2.2, 0]),
    "plane": (a_fixed([0, 0, 1, 1, 1, 0]), [0.3, -0.4, 0, 0, 0, 2.2]),
    "ball joint": (a_fixed([1, 1, 1, 0, 0, 0]), [0, 0, 0, 1.0, 0.5, -1.5]),
    "cross slide": (a_fixed([0, 1, 0, 1, 1, 1]), [0.5, 0, 0.3, 0, 0, 0]),
}


@pytest.mark.parametrize("against", [None, HANDS[1]])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_contact_velocity_removes_the_displacement(g1, kind, against, seed):
    rng = np.random.default_rng(seed)
    make, free = KINDS[kind]
    contact = make(g1, rng, against=against, stiffness=STIFFNESS)
    q, v = random_state(g1, rng)
    # Activated after a motion along the free axes.
    anchor = pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(contact.anchor(dynamics_at(g1, q))) * pin.exp6(np.array(free)))
    e = contact.displacement(dynamics_at(g1, q), anchor)
    assert e.shape == (contact.size,)
    np.testing.assert_allclose(e, 0.0, atol=1e-9)
    rate = rate_along(lambda dynamics: contact.displacement(dynamics, anchor), g1, q, v, 1.0e-6)
    wanted = -contact.jacobian(dynamics_at(g1, q, v)) @ v
    if kind == "wheel":
        wanted[:2] = 0.0  # no position along the plane
    np.testing.assert_allclose(rate, wanted, atol=1e-6 * max(1.0, np.abs(wanted).max()))


@pytest.mark.parametrize("wheel", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_displacement_excludes_rolling(g1, wheel, seed):
    rng = np.random.default_rng(seed)
    contact = (a_wheel if wheel else a_point)(g1, rng, stiffness=STIFFNESS)
    q, _ = random_state(g1, rng)
    dynamics = dynamics_at(g1, q)
    anchor, n = contact.anchor(dynamics), contact.axes(dynamics)[:, 2]
    centre = dynamics.placement(contact._frame_id).act(contact._translation)
    # About any axis for a ball; about the normal for a wheel, which stays upright.
    turn = rng.uniform(-1.5, 1.5) * (n if wheel else np.array(random_place(rng).rotation[:, 0]))
    slid = 0.1 * rng.normal(size=3)
    to = centre + (0.0 if wheel else contact.radius * np.cross(turn, n)) + slid
    rotation = pin.exp3(turn)
    base = pin.SE3(rotation, to - rotation @ centre) * pin.XYZQUATToSE3(q[:7])
    moved = np.concatenate([pin.SE3ToXYZQUAT(base), q[7:]])
    expected = -contact.axes(dynamics).T @ slid
    if wheel:
        expected[:2] = 0.0
    np.testing.assert_allclose(contact.displacement(dynamics_at(g1, moved), anchor), expected, atol=1e-9)


GRIP = settings.FixedContact(
    type="fixed", frame="left_rubber_hand", against="right_rubber_hand", max_force=300.0, max_moment=50.0,
    stiffness=STIFFNESS, damping=DAMPING,
)  # fmt: skip


@pytest.fixture
def standing(bench):
    """Return a function that makes G1 in its stance with stiff contacts, its dynamics, and a board."""

    def make(**contacts):
        robot = bench("g1").on_soles(stiffness=STIFFNESS, damping=DAMPING)
        robot = robot.rebuilt(contacts={**robot.settings.contacts, **contacts})
        dynamics, board = dynamics_at(robot.model, robot.stance), make_board(robot.settings, robot.controller)
        board.reset(dynamics, 0.0)
        return robot, dynamics, board

    return make


@pytest.mark.parametrize("name", ["left_foot", "grip"])
def test_displacement_decays_with_k_and_d(standing, name):
    robot, dynamics, board = standing(**({"grip": GRIP} if name == "grip" else {}))
    contact = robot.controller.contacts[name]
    off = pin.exp6(np.array([3e-3, -2e-3, 1e-3, 0.01, -0.02, 0.015]))
    references = board.sample(0.0)
    anchor = frozen(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(references.anchors[name]) * off))
    references = replace(references, anchors={**references.anchors, name: anchor})
    first = contact.displacement(dynamics, anchor)
    assert np.abs(first[:3]).min() > 5e-4
    state, step, rate, cycles = robot.state(), 2.0e-3, math.sqrt(STIFFNESS), []
    for i in range(1, 151):
        solution = robot.controller.solve(state, references)
        assert not solution.relaxed
        cycles.append((state, solution))
        v = state.v + step * solution.v_dot
        q = pin.integrate(robot.model.pinocchio, state.q, 0.5 * step * (state.v + v))
        state = robot.state(q, v)
        if i % 50 == 0:  # critically damped: D = 2 √K
            now = dynamics_at(robot.model, q)
            decayed = (1.0 + rate * i * step) * math.exp(-rate * i * step)
            found = contact.displacement(now, anchor)
            np.testing.assert_allclose(found, decayed * first, atol=0.02 * np.abs(first).max())
            for other in set(references.anchors) - {name}:
                away = robot.controller.contacts[other].displacement(now, references.anchors[other])
                assert np.abs(away).max() < 1e-5
    # The result is independent of earlier solutions, and of the controller object.
    other = make_qp(robot.settings, robot.model, lambda: 0.0)
    for state, solution in (cycles[10], cycles[140], cycles[0]):
        for controller in (robot.controller, other):
            again = controller.solve(state, references)
            np.testing.assert_allclose(again.v_dot, solution.v_dot, atol=1e-7)
            np.testing.assert_allclose(again.tau, solution.tau, atol=1e-6)


def elsewhere(robot, by):
    """Return the dynamics of the stance after a motion along each axis, m."""
    return dynamics_at(robot.model, np.append(robot.stance[:3] + by, robot.stance[3:]))


def test_anchors_are_set_at_each_activation(standing):
    robot, dynamics, board = standing()
    foot, ramp = robot.controller.contacts["left_foot"], robot.settings.contacts["left_foot"].ramp

    def displacement(dynamics, time):
        return foot.displacement(dynamics, board.sample(time).anchors["left_foot"])

    def switch(enabled, dynamics, time):
        board.apply([EnableContact("left_foot", enabled)], dynamics, time)

    early = board.sample(0.0)
    assert set(early.anchors) == {"left_foot", "right_foot"}
    a, b, c = (elsewhere(robot, by) for by in (0.01, 0.02, 0.03))
    np.testing.assert_allclose(np.linalg.norm(displacement(a, 0.0)[:3]), math.sqrt(3.0) * 0.01)
    switch(True, a, 1.0)  # active already
    switch(False, a, 2.0)
    switch(True, b, 2.0 + 0.5 * ramp)  # still active: keeps its anchor
    np.testing.assert_allclose(displacement(dynamics, 3.0), 0.0, atol=1e-12)
    switch(False, b, 4.0)
    np.testing.assert_allclose(displacement(dynamics, 4.0 + 0.5 * ramp), 0.0, atol=1e-12)
    switch(True, c, 6.0)
    np.testing.assert_allclose(displacement(c, 6.0 + 0.01 * ramp), 0.0, atol=1e-12)
    other = board.sample(7.0).anchors["right_foot"]
    np.testing.assert_array_equal(other, early.anchors["right_foot"])
    board.reset(b, 8.0)
    np.testing.assert_allclose(displacement(b, 8.0), 0.0, atol=1e-12)
    # Earlier samples do not change.
    np.testing.assert_allclose(foot.displacement(dynamics, early.anchors["left_foot"]), 0.0, atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        early.anchors["left_foot"][0] = 1.0


def test_anchor_of_a_slipping_contact_moves_with_it(standing):
    robot, _, board = standing()
    foot, moved, before = robot.controller.contacts["left_foot"], elsewhere(robot, 0.01), board.sample(0.0).anchors
    board.anchor_slipping_contacts(moved)
    assert board.sample(0.0).anchors is before
    board.apply([SetSlippingContacts(("left_foot",))], moved, 1.0)
    board.anchor_slipping_contacts(moved)
    anchors = board.sample(1.0).anchors
    np.testing.assert_allclose(foot.displacement(moved, anchors["left_foot"]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(anchors["right_foot"], before["right_foot"])


def test_missing_anchor_is_named(standing):
    robot, _, board = standing()
    references = board.sample(0.0)
    only_right = replace(references, anchors={"right_foot": references.anchors["right_foot"]})
    with pytest.raises(ConfigurationError, match=r"'left_foot' has stiffness = 100 1/s².*anchors: right_foot"):
        robot.controller.solve(robot.state(), only_right)
