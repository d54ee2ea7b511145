"""Changes of settings in a running controller."""

import numpy as np
import pytest
from refusals import refusal

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.live_settings import LiveSettings
from wbc_controller.nodes.ros2.parameters import flatten
from wbc_controller.settings import Settings
from wbc_controller.settings.nesting import merged, nested
from wbc_controller.simulation.simulation import Simulation

#: All kinds of tasks, with all keys.
MORE = {
    "spin": {"type": "angular_momentum"},
    "steady": {"type": "capture_point"},
    "look": {"type": "gaze", "frame": "base", "axis": [1.0, 0.0, 0.0]},
}


@pytest.fixture(scope="module")
def tuner(robot_of):
    settings, model = robot_of("go2")
    settings = Settings.model_validate(merged(settings.model_dump(exclude_unset=True), {"tasks": MORE}))
    controller = make_qp(settings, model)
    return lambda: LiveSettings(settings, controller)


def other(value):
    if isinstance(value, bool):
        return not value
    return 0.9 * value if value else 0.001


def keys(settings, live):
    numbers = {
        key: value
        for key, value, description in flatten(settings)
        if isinstance(value, (bool, float)) and description.endswith("May be changed live.") == live
    }
    assert len(numbers) > 15
    return numbers


def test_every_live_key_changes_the_live_part(tuner):
    for key, value in keys(tuner().settings, True).items():
        changed = tuner()
        before = repr(changed.newest)
        changed.accept(nested({key: other(value)}), "test")
        assert repr(changed.newest) != before, key


def test_every_other_key_is_refused_by_name(tuner):
    for key, value in keys(tuner().settings, False).items():
        changed = tuner()
        settings, newest = changed.settings, changed.newest
        assert key in refusal(changed.accept, nested({key: other(value)}), "test")
        assert (changed.settings, changed.newest) == (settings, newest)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tasks.com.stiffness": -1.0}, "test: tasks.com.stiffness = -1.0: input should be greater than"),
        ({"tasks.com.stiffness": [1.0, 2.0]}, "2 values; expected one number, or"),
        ({"tasks.posture.stiffness": [1.0, 2.0]}, "tasks.posture.stiffness has 2 values"),
        ({"tasks.com.stifness": 1.0}, "test: tasks.com.stifness: unknown key; did you mean 'stiffness'?"),
        ({"tasks.foot.type": "com"}, "test: tasks.foot: read only when the controller is configured"),
        ({"tasks.com.type": "linear_momentum", "tasks.com.stiffness": 1.0}, "unknown key"),
        ({"limits.position_margin": 1.0}, "limits.position_margin = 1: valid in a running controller: 0 to 0.2"),
        ({"limits.acceleration": 1.0e5}, "limits.acceleration = 100000: valid in a running controller: 20 to 400"),
        ({"limits.acceleration": 19.9, "limits.velocity_scale": 0.09}, "limits.velocity_scale = 0.09: valid in"),
        ({"limits.position_margin": 0.01, "control.rate": 100.0}, "test: control.rate: read only when"),
        ({"robot.joints": ["a"]}, "robot.posture has"),
    ],
)
def test_changes_are_atomic(tuner, change, said):
    changed = tuner()
    settings, newest = changed.settings, changed.newest
    for method in (changed.validated, changed.accept):
        assert said in refusal(method, nested(change), "test")
    assert (changed.settings, changed.newest) == (settings, newest)


def test_checks_and_empty_changes_have_no_effect_and_others_are_logged(tuner, caplog):
    changed, news = tuner(), []
    changed.changed = lambda: news.append(1)
    newest = changed.newest
    changed.validated({"tasks": {"com": {"stiffness": 1.0}}}, "test")
    changed.accept({"tasks": {"com": {"weight": changed.settings.tasks["com"].weight}}}, "test")
    assert (changed.newest is newest, news) == (True, [])
    caplog.set_level("INFO")
    changed.accept({"tasks": {"com": {"stiffness": 7}}}, "update")
    assert (changed.newest is newest, news) == (False, [1])
    assert "update: tasks.com.stiffness: " in caplog.text
    assert "-> 7.0" in caplog.text


def standing(bench, **changes):
    """Robot at rest with an error of 2 cm of the centre of mass: the torques depend on the gains."""
    quick = {"safety": {"activation_ramp": 0.0}, "tasks": {"com": {"setpoint_duration": 0.1}}}
    controller = bench(changes=merged(quick, changes))
    controller.activate()
    x, y, z = controller.loop.controller.qp.dynamics.com
    controller.say("update", f"{{tasks: {{com: {{setpoint: [{x + 0.02}, {y}, {z}]}}}}}}")
    controller.cycle(200)
    return controller


def weight(controller):
    return controller.loop.controller.board.sample(controller.clock.time).weights["com"]


def test_gains_ramp_to_the_configured_result(bench):
    controller = standing(bench)
    still = controller.reports[-1].command.tau
    controller.say("update", "{tasks: {com: {stiffness: 400.0}}}")
    ramped = round(controller.settings.control.weight_ramp / controller.period)
    controller.cycle(ramped + 2)
    tau = controller.reports[-1].command.tau
    whole = np.abs(tau - still).max()
    assert whole > 0.5  # N·m
    steps = np.diff([report.command.tau for report in controller.reports[-ramped - 3 :]], axis=0)
    assert np.abs(steps).max() < 3.0 * whole / ramped
    made = standing(bench, tasks={"com": {"stiffness": 400.0}})
    np.testing.assert_allclose(tau, made.reports[-1].command.tau, atol=1e-5)


def test_the_weight_of_the_settings_is_ramped_too_and_outlives_a_reset(bench):
    controller = standing(bench)
    controller.loop.controller.live.accept({"tasks": {"com": {"weight": 1.0}}}, "test")
    weights = [controller.cycle() and weight(controller) for _ in range(300)]
    assert np.abs(np.diff(weights)).max() < 0.02 * (weights[0] - weights[-1])
    assert weights[-1] == 1.0
    for word in ("damp", "reset", "activate"):
        controller.request(word)
    controller.cycle(300)
    assert weight(controller) == 1.0


def test_updates_of_references_and_settings_are_atomic(bench):
    controller = bench(changes={"control": {"weight_ramp": 0.1}})
    both = "{tasks: {com: {stiffness: 7.0, weight: 3.0}}}"
    controller.say("update", "{tasks: {com: {damping: 7.0}}}")
    assert controller.cycle().refused == ()  # a change of settings alone applies at the activation
    controller.say("update", both)
    (sentence,) = controller.cycle().refused
    assert "the controller is inactive" in sentence
    before = controller.loop.controller.live.settings
    assert before.tasks["com"].stiffness != 7.0
    controller.activate()
    controller.cycle()
    np.testing.assert_array_equal(controller.loop.controller.qp.tasks["com"].damping, 7.0)
    controller.say("update", "{tasks: {com: {stiffness: -7.0, weight: 3.0}}}")
    (sentence,) = controller.cycle().refused
    assert "update: tasks.com.stiffness = -7.0: input should be" in sentence
    assert controller.loop.controller.live.settings == before
    controller.cycle(60)
    assert weight(controller) == before.tasks["com"].weight
    controller.say("update", both)
    assert controller.cycle().refused == ()
    controller.cycle(60)
    assert weight(controller) == 3.0
    assert controller.loop.controller.qp.tasks["com"].stiffness == 7.0


def test_the_torque_speed_curve_outlives_a_change_of_the_limits(bench):
    """A knee above its corner speed has less torque in every cycle, during all changes."""
    robot = standing(bench, limits={"torque_speed": {"enabled": True, "corner": 0.01, "no_load": 0.5}})
    speed = np.zeros(robot.model.na)
    knee = next(i for i, joint in enumerate(robot.model.joints) if "calf" in joint)
    speed[knee] = 0.1 * robot.model.velocity_limits[knee]
    for acceleration in (robot.settings.limits.acceleration, 50.0):
        _, upper = robot.loop.controller.qp.formulation.torque_limit.available(speed)
        assert upper[knee] < 0.95 * robot.model.effort_limits[knee]
        assert robot.loop.controller.qp.formulation.motion_limit.acceleration == acceleration
        robot.say("update", "{limits: {acceleration: 50.0}, control: {weight_ramp: 0.0}}")
        robot.cycle(2)


@pytest.mark.parametrize(
    ("configured", "value", "good"),
    [(200.0, 20.0, True), (200.0, 200.0, True), (200.0, 200.1, False), (500.0, 500.0, True), (3.0, 3.0, True),
     (3.0, 2.9, False), (3.0, 20.0, False)],
)  # fmt: skip
def test_live_range_ends_at_the_configured_value(robot_of, changed, configured, value, good):
    settings, model = robot_of("go2")
    settings = changed(settings, {"limits": {"acceleration": configured}})
    live = LiveSettings(settings, make_qp(settings, model))
    live.accept({"limits": {"acceleration": min(30.0, configured)}}, "test")
    if good:
        live.accept({"limits": {"acceleration": value}}, "test")
    else:
        assert "valid in a running controller: " in refusal(live.accept, {"limits": {"acceleration": value}}, "test")


@pytest.mark.parametrize(
    ("robot", "key", "end"), [("g1", "position_margin", 1), ("go2", "velocity_scale", 0), ("go2", "acceleration", 0)]
)
def test_the_ends_of_the_live_ranges_are_safe(robot, key, end):
    """Stand, then sway within joint limits, without relaxation."""
    simulation = Simulation(robot, preflight=False)
    controller, model = simulation.controller, simulation.controller.model
    value = controller.config.settings.limits.live_ranges[key][end]
    controller.update({"limits": {key: value}, "control": {"weight_ramp": 0.1}})
    controller.set("com", controller.dynamics.com + [0.01, 0.02, -0.03], duration=0.3)
    results = simulation.run(0.5)
    q = simulation.plant.state()[0][model.q_index]
    assert not any(result.solution.relaxed for result in results)
    assert (q >= model.position_lower).all()
    assert (q <= model.position_upper).all()
