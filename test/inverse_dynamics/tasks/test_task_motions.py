"""Motion under tasks, by integration of the controller's accelerations.

There is no simulator, so the motion shows the law of the task. The references come from the board, as in the service.
"""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.inverse_dynamics.references.changes import SetSetpoint
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import RobotState, frozen

PERIOD = 0.002


class Motion:
    """Standing robot with further tasks that moves by its controller's accelerations."""

    def __init__(self, settings, model, q):
        self.model = model
        self.controller = make_qp(settings, model)
        self.board = make_board(settings, self.controller)
        self.now = Dynamics(model)
        self.now.update(np.array(q), np.zeros(model.nv))
        self.board.reset(self.now, 0.0)
        self.time = 0.0
        self.solution = None

    def go(self, **setpoints):
        changes = [SetSetpoint(name, np.array(position, dtype=float)) for name, position in setpoints.items()]
        self.board.apply(changes, self.now, self.time)

    def run(self, seconds, each=lambda motion: None):
        for _ in range(round(seconds / PERIOD)):
            q, v = self.now.q, self.now.v
            self.solution = self.controller.solve(RobotState(0, frozen(q), frozen(v)), self.board.sample(self.time))
            assert not self.solution.relaxed
            v_dot = self.solution.v_dot
            self.now.update(
                pin.integrate(self.model.pinocchio, q, PERIOD * v + 0.5 * PERIOD**2 * v_dot), v + PERIOD * v_dot
            )
            self.time += PERIOD
            each(self)

    def task(self, name):
        return self.controller.tasks[name]

    def placement(self, frame):
        return self.now.placement(self.model.pinocchio.getFrameId(frame))


@pytest.fixture
def motion(robot_of, stance_of, changed):
    """Return a function that makes a `Motion` of a robot with changed settings."""

    def build(robot, changes):
        settings, model = robot_of(robot)
        return Motion(changed(settings, changes), model, stance_of(robot))

    return build


def test_relative_pose_of_two_hands(motion):
    grip = {"type": "relative_pose", "frame": "left_rubber_hand", "reference_frame": "right_rubber_hand"}
    g1 = motion("g1", {"tasks": {"grip": grip | {"weight": 20.0}, "right_hand": {"enabled": True}}})
    start = g1.task("grip").position(g1.now)
    goal = start + np.array([0.0, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0])
    g1.go(grip=goal)
    g1.run(1.2)
    np.testing.assert_allclose(g1.task("grip").position(g1.now)[:3], goal[:3], atol=1.0e-3)
    # The right hand moves and turns; the left one follows.
    here, left = g1.placement("right_rubber_hand"), np.array(g1.placement("left_rubber_hand").translation)
    turned = (
        pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.05]))
        * here
        * pin.SE3(pin.exp3(np.array([0.2, 0.0, 0.2])), np.zeros(3))
    )
    g1.go(right_hand=pin.SE3ToXYZQUAT(turned))
    errors = []
    g1.run(1.5, lambda g1: errors.append(g1.task("grip").error(g1.now, goal)))
    assert np.linalg.norm(g1.placement("right_rubber_hand").translation - turned.translation) < 0.01
    assert np.linalg.norm(g1.placement("left_rubber_hand").translation - left) > 0.04
    print(f"largest relative error on the way: {np.abs(errors).max(axis=0)}")
    assert np.abs(errors).max() < 5.0e-3


def shove(g1, momentum):
    """Give a robot a centroidal momentum (6,) with resting feet: the slowest such motion."""
    J = np.concatenate([contact.jacobian(g1.now) for contact in g1.controller.contacts.values()])
    _, values, rows = np.linalg.svd(J)
    free = rows[np.sum(values > 1.0e-9) :].T
    v = free @ np.linalg.lstsq(g1.now.centroidal_matrix @ free, np.array(momentum, dtype=float), rcond=None)[0]
    g1.now.update(g1.now.q, v)
    return g1


#: Other tasks on the centre of mass or the trunk are disabled.
ALONE = {"com": {"enabled": False}, "pelvis": {"weight": 0.1}, "torso": {"weight": 0.1}}


@pytest.mark.parametrize(
    ("kind", "damping", "weight", "start"),
    [("linear_momentum", [4.0, 8.0, 4.0], 1.0, [3.0, 3.0, 2.0]), ("angular_momentum", 6.0, 10.0, [0.4, 0.4, 0.2])],
)
def test_momentum_decays_with_its_damping(motion, kind, damping, weight, start):
    g1 = motion("g1", {"tasks": ALONE | {"rate": {"type": kind, "damping": damping, "weight": weight}}})
    shove(g1, [*start, 0.0, 0.0, 0.0] if kind == "linear_momentum" else [0.0, 0.0, 0.0, *start])
    np.testing.assert_allclose(g1.task("rate").position(g1.now), start, atol=1e-6)
    time = []
    g1.run(0.4, lambda g1: time.append(g1.task("rate").position(g1.now)))
    expected = start * np.exp(-np.array(damping) * PERIOD * np.arange(1, len(time) + 1)[:, None])
    assert np.abs(np.array(time) - expected).max() < 0.02 * np.abs(start).max()


def test_capture_point_error_decays(motion):
    task = {"type": "capture_point", "gain": [3.0, 5.0], "weight": 500.0, "setpoint_duration": 0.0}
    height = {"com": {"mask": [False, False, True]}}
    g1 = shove(motion("g1", {"tasks": height | {"steady": task}}), [1.5, 2.0, 0.0, 0.0, 0.0, 0.0])
    goal = g1.now.com[:2] + np.array([0.01, -0.01])
    g1.go(steady=goal)
    start, errors = g1.task("steady").error(g1.now, goal), []
    g1.run(2.0, lambda g1: errors.append(g1.task("steady").error(g1.now, goal)))
    expected = start * np.exp(-np.array([3.0, 5.0]) * PERIOD * np.arange(1, len(errors) + 1)[:, None])
    largest = np.abs(np.array(errors) - expected).max()
    print(
        f"from {1e3 * start} mm: {1e3 * largest:.2f} mm off the exponential; com {1e3 * (g1.now.com[:2] - goal)} mm off"
    )
    assert largest < 0.03 * np.abs(start).max()
    np.testing.assert_allclose(g1.now.com[:2], goal, atol=1.0e-3)
