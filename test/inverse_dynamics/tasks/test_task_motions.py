"""Motion under each kind of task, by integration of the controller's accelerations.

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
from wbc_controller.simulation.plant import Plant

PERIOD = 0.002


class Motion:
    """Standing robot with further tasks that moves by its controller's accelerations."""

    def __init__(self, settings, model, q, v=None):
        self.model = model
        self.controller = make_qp(settings, model)
        self.board = make_board(settings, self.controller)
        self.now = Dynamics(model)
        self.now.update(np.array(q), np.zeros(model.nv) if v is None else v)
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

    def build(robot, changes, v=None):
        settings, model = robot_of(robot)
        return Motion(changed(settings, changes), model, stance_of(robot), v)

    return build


def test_relative_pose_of_two_hands(motion):
    grip = {"type": "relative_pose", "frame": "left_rubber_hand", "reference_frame": "right_rubber_hand"}
    g1 = motion("g1", {"tasks": {"grip": grip | {"weight": 20.0}, "right_hand": {"enabled": True}}})
    start = g1.task("grip").position(g1.now)
    goal = start + np.array([0.0, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0])
    g1.go(grip=goal)
    g1.run(1.5)
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


def test_axis_alignment_of_a_hand(motion):
    task = {"type": "axis_alignment", "frame": "left_rubber_hand", "axis": [1.0, 0.0, 0.0], "weight": 10.0}
    g1 = motion("g1", {"tasks": {"aim": task}})
    turned = []
    for goal in ([0.0, 0.0, -1.0], [0.0, 5.0, 5.0]):
        g1.go(aim=goal)
        g1.run(2.0)
        axis = g1.placement("left_rubber_hand").rotation[:, 0]
        turned.append(float(np.arccos(axis @ goal / np.linalg.norm(goal))))
    print(f"angles left: {turned} rad")
    assert max(turned) < 2.0e-3


def test_gaze_while_swaying(motion):
    task = {"type": "gaze", "frame": "torso_link", "axis": [1.0, 0.0, 0.0], "weight": 10.0}
    g1 = motion("g1", {"tasks": {"aim": task, "torso": {"enabled": False}}})
    point = np.array([0.8, 0.25, 1.0])
    g1.go(aim=point)
    g1.run(2.0)
    angles = []
    for side in (0.03, -0.03):
        g1.go(com=[*g1.now.com[:1], side, g1.now.com[2]])
        g1.run(1.2, lambda g1: angles.append(np.linalg.norm(g1.task("aim").error(g1.now, point))))
    here = g1.placement("torso_link")
    x, y, z = here.actInv(point)
    print(f"largest angle {max(angles):.1e} rad; off the axis {np.hypot(y, z):.1e} m at {x:.2f} m")
    assert max(angles) < 2.0e-3
    assert np.hypot(y, z) < 2.0e-3 * x


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


def test_linear_momentum_follows_its_reference(motion):
    task = {"type": "linear_momentum", "weight": 1.0, "setpoint_duration": 0.2}
    g1 = motion("g1", {"tasks": ALONE | {"sway": task}})
    goal = np.array([0.0, 2.0, -1.0])
    g1.go(sway=goal)
    g1.run(0.3)
    reached = g1.task("sway").position(g1.now)
    print(f"momentum {reached} kg·m/s of {goal}")
    np.testing.assert_allclose(reached, goal, atol=0.02)


def test_capture_point_error_decays(motion):
    task = {"type": "capture_point", "gain": [3.0, 5.0], "weight": 500.0, "setpoint_duration": 0.0}
    height = {"com": {"mask": [False, False, True]}}
    g1 = shove(motion("g1", {"tasks": height | {"steady": task}}), [1.5, 2.0, 0.0, 0.0, 0.0, 0.0])
    goal = g1.now.com[:2] + np.array([0.01, -0.01])
    g1.go(steady=goal)
    start, errors = g1.task("steady").error(g1.now, goal), []
    g1.run(2.5, lambda g1: errors.append(g1.task("steady").error(g1.now, goal)))
    expected = start * np.exp(-np.array([3.0, 5.0]) * PERIOD * np.arange(1, len(errors) + 1)[:, None])
    largest = np.abs(np.array(errors) - expected).max()
    print(
        f"from {1e3 * start} mm: {1e3 * largest:.2f} mm off the exponential; com {1e3 * (g1.now.com[:2] - goal)} mm off"
    )
    assert largest < 0.03 * np.abs(start).max()
    np.testing.assert_allclose(g1.now.com[:2], goal, atol=1.0e-3)


def test_capture_point_after_a_push_in_the_simulator(robot_of, changed):
    """12 N·s sideways at the pelvis in 0.1 s: the capture point stays over the feet and returns."""
    settings, model = robot_of("g1")
    steady = {"type": "capture_point", "gain": 15.0, "weight": 5000.0, "setpoint_duration": 0.0}
    tasks = {"com": {"mask": [False, False, True]}, "steady": steady}
    settings = changed(settings, {"tasks": tasks})
    controller, plant = make_qp(settings, model), Plant(model, settings)
    board, dynamics = make_board(settings, controller), controller.dynamics
    plant.hold(False, ramp=0.0)
    dynamics.update(*plant.state())
    board.reset(dynamics, 0.0)
    task, tau, out = controller.tasks["steady"], None, []
    start = np.array(task.position(dynamics))
    for cycle in range(1200):
        if cycle == 100:
            plant.push("pelvis", [0.0, 120.0, 0.0, 0.0, 0.0, 0.0], 0.1)
        q, v = plant.state()
        solution = controller.solve(RobotState(plant.stamp, frozen(q), frozen(v)), board.sample(cycle * PERIOD), tau)
        tau = solution.tau
        plant.apply(tau)
        out.append(task.position(dynamics) - start)
        for _ in range(plant.steps_per_period):
            plant.step()
    assert not plant.fallen
    outside = np.linalg.norm(out, axis=1)
    print(f"capture point out by {1e3 * outside.max():.0f} mm, in the end {1e3 * outside[-1]:.1f} mm")
    assert outside[:100].max() < 2.0e-3
    assert 0.03 < outside.max() < 0.12
    assert outside[-1] < 3.0e-3
