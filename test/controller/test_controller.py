"""Python API: states to supervised torques, references and settings by name, errors."""

import numpy as np
import pytest
from refusals import input_refusal, refusal
from snapshots import dynamics_at

import wbc_controller as wbc
from wbc_controller.records import Mode
from wbc_controller.validation.fuzz.hostile_classes import Ceiling, Height

PERIOD = 0.002


@pytest.fixture(scope="module")
def made():
    return wbc.Controller("go2")


@pytest.fixture
def controller(made):
    """Controller after a reset."""
    made.reset(made.stance(), np.zeros(made.model.nv))
    return made


def run(controller, seconds, start=0.0):
    """Step repeatedly at rest in the stance."""
    q, v = controller.stance(), np.zeros(controller.model.nv)
    return [controller.step(q, v, start + i * PERIOD) for i in range(round(seconds / PERIOD))]


def test_controller_equals_service(bench, make):
    """The same states and requests by topics and by Python: equal torques."""
    service = bench()
    front = wbc.Controller(service.settings, model=service.model)
    service.activate()
    front.reset(service.q, service.v, service.time * 1e-9)
    front.step(service.q, service.v, service.time * 1e-9)
    rng = np.random.default_rng(3)
    differences = []
    for cycle in range(300):
        if cycle == 100:
            goal = front.dynamics.com + [0.01, 0.02, -0.03]
            text = f"{{tasks: {{com: {{setpoint: {goal.tolist()}}}}}}}"
            service.send("update", make.string(text))
            front.set("com", goal)
        if cycle == 150:
            service.send("contact_enable", make.bool(False), "front_left_foot")
            front.disable("front_left_foot")
        service.v = 0.01 * rng.normal(size=front.model.nv)
        report = service.cycle()
        result = front.step(service.q, service.v, service.time * 1e-9)
        differences.append(np.abs(result.tau - report.command.tau).max())
    assert report.mode is result.mode is Mode.ACTIVE
    assert max(differences) < 1e-9  # clock and timestamps are rounded differently


def test_a_reset_starts_anew_bit_for_bit(controller):
    first = [result.tau for result in run(controller, 0.3)]
    controller.set("com", controller.dynamics.com + 0.02)
    controller.disable("front_left_foot")
    run(controller, 0.5, start=0.3)
    controller.request("estop")
    assert controller.mode is Mode.FAULT
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    assert (controller.mode, controller.fault) == (Mode.ACTIVE, None)
    np.testing.assert_array_equal(first, [result.tau for result in run(controller, 0.3)])


def test_streamed_reference_applies_to_one_step(controller):
    run(controller, 0.1)
    goal = controller.dynamics.com + [0.0, 0.01, 0.0]
    controller.set("com", goal, velocity=[0.0, 0.3, 0.0], acceleration=[0.0, 0.0, 1.0])
    q, v = controller.stance(), np.zeros(controller.model.nv)
    followed = controller.step(q, v, 0.1).references.tasks["com"]
    np.testing.assert_array_equal(followed.position, goal)
    np.testing.assert_array_equal([followed.velocity, followed.acceleration], [[0.0, 0.3, 0.0], [0.0, 0.0, 1.0]])
    after = controller.step(q, v, 0.102).references.tasks["com"]
    np.testing.assert_array_equal(after.position, goal)
    assert not np.any([after.velocity, after.acceleration])


def test_a_trajectory_goes_through_its_points(controller):
    run(controller, 0.1)
    points = controller.dynamics.com + np.array([[0.0, 0.02, 0.0], [0.0, -0.02, 0.01]])
    controller.follow("com", [0.2, 0.5], points, velocities=[[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    at = {round(result.time - 0.1, 6): result.references.tasks["com"] for result in run(controller, 0.6, start=0.1)}
    np.testing.assert_allclose([at[0.2].position, at[0.5].position], points, atol=1e-9)
    np.testing.assert_allclose(at[0.2].velocity, [0.0, 0.1, 0.0], atol=1e-9)
    np.testing.assert_array_equal(at[0.598].position, points[1])


def test_joints_of_a_posture_are_set_by_name(controller):
    run(controller, 0.1)
    before = controller.board.present("posture", 0.1).position.copy()
    controller.set("posture", {"FL_thigh_joint": 0.7})
    controller.set("posture", {"RR_calf_joint": -1.4})
    (*_, last) = run(controller, 1.2, start=0.1)
    after = last.references.tasks["posture"].position
    moved = [controller.model.joints.index(name) for name in ("FL_thigh_joint", "RR_calf_joint")]
    np.testing.assert_array_equal(after[moved], [0.7, -1.4])
    np.testing.assert_array_equal(np.delete(after, moved), np.delete(before, moved))


def test_a_foot_is_unloaded_smoothly_from_its_present_force():
    simulation = wbc.Simulation("g1")
    controller = simulation.controller
    controller.set("com", controller.dynamics.com - [0.0, 0.07, 0.0])
    before = simulation.run(1.3)[-1].forces["left_foot"][2]
    assert before > 50.0
    controller.disable("left_foot")
    forces = [result.forces["left_foot"][2] for result in simulation.run(0.198)]
    assert forces[0] == pytest.approx(before, rel=0.01)
    changes = np.diff(forces)
    assert changes.max() < 0.01
    assert changes.min() > -3.1 * before * controller.period / 0.2  # derivative of (1 - t / T)³ at its start
    assert forces[-1] < 0.01
    assert set(simulation.run(0.01)[-1].forces) == {"right_foot"}


@pytest.mark.parametrize("by_settings", [False, True])
def test_the_anchor_of_a_contact_is_its_pose_in_the_state_of_its_cycle(by_settings):
    foot = "front_left_foot"
    controller = wbc.Controller(wbc.load("go2").replace({f"contacts.{foot}.stiffness": 100.0}))
    q, still = controller.stance(), np.zeros(controller.model.nv)
    controller.reset(q, still, 0.0)
    controller.disable(foot)
    run(controller, 0.3, start=PERIOD)
    moved = q.copy()
    moved[0] += 0.003
    if by_settings:  # as the service does
        controller.live.accept({"contacts": {foot: {"enabled": False}}}, "test")
        controller.step(q, still, 0.302)
        controller.live.accept({"contacts": {foot: {"enabled": True}}}, "test")
    else:
        controller.enable(foot)
    result = controller.step(moved, still, 0.304)
    there = controller.contacts[foot].pose(dynamics_at(controller.model, moved)).translation
    assert result.references.anchors[foot][:3] == pytest.approx(there)
    assert result.references.contacts[foot] < 1e-3


def test_the_walker_plans_with_the_state_of_its_cycle():
    simulation = wbc.Simulation("g1")
    controller, seen = simulation.controller, []
    update = controller.walker.update
    controller.walker.update = lambda time, dynamics, *rest: (seen.append(dynamics.q), update(time, dynamics, *rest))[1]
    controller.walk(0.1)
    results = simulation.run(0.05)
    assert len(seen) == len(results)
    assert all(np.array_equal(q, result.state.q) for q, result in zip(seen, results, strict=True))


def test_weights_contacts_and_settings_are_ramped_and_a_known_load_is_carried(controller):
    run(controller, 0.1)
    controller.set_weight("com", 5.0)
    controller.disable("contacts.front_left_foot")
    controller.update({"tasks.com.stiffness": 400.0})
    results = run(controller, 0.6, start=0.1)
    weights = [result.references.weights["com"] for result in results]
    contacts = [result.references.contacts["front_left_foot"] for result in results]
    assert 50.0 > weights[50] > weights[150] > weights[-1] == 5.0
    assert 1.0 > contacts[10] > contacts[50] > contacts[-1] == 0.0
    assert "front_left_foot" not in results[-1].forces
    assert controller.tasks["com"].stiffness == 400.0
    controller.enable("front_left_foot")
    assert run(controller, 0.6, start=0.7)[-1].references.contacts["front_left_foot"] == 1.0
    controller.update({"tasks.com.stiffness": 100.0})
    controller.set_external_wrench("base", [0.0, 0.0, -30.0, 0.0, 0.0, 0.0])
    (result,) = run(controller, PERIOD, start=1.3)
    weight = controller.model.mass * controller.model.gravity
    assert sum(force[2] for force in result.forces.values()) == pytest.approx(weight + 30.0, rel=1e-3)


def test_requests_end_as_on_the_topic(controller):
    run(controller, 0.3)
    controller.request("deactivate")
    result = run(controller, 0.4, start=0.3)[-1]
    assert (result.mode, result.command) == (Mode.INACTIVE, None)
    assert not result.tau.any()
    assert "command 'damp' has no effect: the controller is inactive" in input_refusal(controller.request, "damp")
    assert "'activate' requires a state; call reset" in input_refusal(controller.request, "activate")
    assert "command 'stop' is unknown; did you mean 'estop'" in input_refusal(controller.request, "stop")


def test_calls_before_the_first_state_are_refused():
    controller = wbc.Controller("go2", preflight=False)
    for call, *arguments in (
        (controller.set, "com", [0.0, 0.0, 0.3]),
        (controller.set, "posture", {"FL_hip_joint": 0.0}),
        (controller.disable, "com"),
        (controller.step, controller.stance(), np.zeros(controller.model.nv), 0.0),
    ):
        assert "has no state; call reset" in input_refusal(call, *arguments)


def test_the_configuration_is_checked_as_by_the_command():
    changes = {"contacts.right_foot.max_normal_force": 10.0, "contacts.left_foot": None, "walking": None}
    config = wbc.load("g1").replace(changes)
    assert "g1.yaml: the robot cannot stand still in robot.posture" in refusal(wbc.Controller, config)
    assert wbc.Controller(config, preflight=False).mode is Mode.INACTIVE
    results = []
    for controller in (wbc.Controller("g1"), wbc.Controller("g1", preflight=False)):
        controller.reset(controller.stance(), np.zeros(controller.model.nv))
        controller.set("com", controller.dynamics.com + [0.01, 0.02, -0.03])
        results.append([result.solution.v_dot for result in run(controller, 0.1)])
    np.testing.assert_array_equal(*results)
    assert np.abs(results[0][-1][:6]).max() > 0.01  # the base accelerates


class Heavy(Height):
    weight = 7.0


def test_own_tasks_and_limits_take_part():
    config = wbc.load("go2").replace({"tasks.com": None})
    controller = wbc.Controller(config, tasks=[Heavy], limits=[lambda model: Ceiling(model, 0.05)])
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    run(controller, 0.3)
    assert controller.board.plans["height"].weight == 7.0
    controller.set("height", controller.dynamics.com[2] + 0.1, velocity=[0.0])
    (result,) = run(controller, PERIOD, start=0.3)
    assert result.task_errors["height"] == pytest.approx(0.1, abs=1e-6)
    assert result.binding["ceiling:com"] > 0.0
    assert isinstance(controller.limits["ceiling"], Ceiling)
    acceleration = controller.dynamics.com_jacobian @ result.v_dot + controller.dynamics.com_drift
    assert acceleration[2] == pytest.approx(0.05, abs=1e-6)
    controller.update({"tasks.posture.weight": 0.1})  # settings change, user tasks remain
    controller.disable("height")
    assert run(controller, 1.0, start=0.302)[-1].references.weights["height"] == 0.0


@pytest.mark.parametrize(
    ("own", "sentence"),
    [
        ({"tasks": [lambda model: Height(model, "com")]}, "tasks: duplicate name 'com'"),
        ({"tasks": [Height, Height]}, "tasks: duplicate name 'height'"),
        ({"tasks": [Ceiling]}, "returned a Ceiling, expected a Task"),
        ({"limits": [lambda model: None]}, "returned a NoneType, expected a RowLimit"),
        ({"tasks": [int]}, "tasks: <class 'int'> raised TypeError"),
    ],
)
def test_invalid_user_objects_are_refused(own, sentence):
    assert sentence in refusal(wbc.Controller, "go2", **own, preflight=False)
