"""Robots walk in simulation by a velocity command, stop and stand; a saved state continues exactly."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gaits import run_to, simulated, velocity_of, walking
from refusals import input_refusal
from stepping import simulate

import wbc_controller as wbc
from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics.references.changes import Walk
from wbc_controller.middleware.topics import WALKING_KEYS
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.recording.json_records import from_json, to_json
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.walking.biped import BipedWalker
from wbc_controller.walking.feet import Foot
from wbc_controller.walking.footsteps import Footstep, Goal, Velocity
from wbc_controller.walking.gait import Phase
from wbc_controller.walking.touchdown import LATEST

#: Command forward, sideways and turning, m/s and rad/s.
COMMANDS = [("g1", (-0.15, 0.1, 0.3)), ("talos", (0.3, 0.0, 0.0)), ("go2", (0.4, 0.2, 0.4))]


@pytest.mark.parametrize(("robot", "command"), COMMANDS)
def test_a_robot_walks_far_from_the_origin_as_commanded_and_stops(robot, command):
    """The programs of the gait are prepared before the first step.

    Far from the origin, setpoints must be near the robot, also in components that a task does not use.
    """
    simulation, controller, _ = simulated(robot, {"walking.max_speed": 2.0 * abs(command[0])})
    q, v = simulation.plant.state()
    simulation.plant.set_state([q[0] + 300.0, q[1] - 200.0, *q[2:]], v)
    controller.reset(*simulation.plant.state(), simulation.time)
    for _ in range(100):  # torque ramp
        simulation._cycle()
    qp = controller.qp
    prepared = set(qp.formulation._structures), set(qp._solvers)
    controller.walk(*command)
    results = simulation.run(2.7)
    assert controller.walker.phase in (Phase.SINGLE, Phase.DOUBLE)
    walked = simulation.run(2.4)
    *along, turned = velocity_of(walked)
    assert along == pytest.approx(command[:2], abs=0.05)
    assert turned == pytest.approx(command[2], abs=0.02)
    controller.stand()
    results += walked + simulation.run(3.2)
    assert controller.walker.phase is Phase.STAND
    assert not any(result.relaxed for result in results)
    assert np.abs(simulation.plant.state()[1]).max() < 0.02
    assert set(results[-1].forces) == set(controller.contacts)
    assert (set(qp.formulation._structures), set(qp._solvers)) == prepared


@pytest.mark.parametrize(("robot", "lowering"), [("g1", 0.032), ("go2", 0.02)])
def test_a_second_walk_is_as_high_as_the_first(robot, lowering):
    """The robot stands as high as it has walked."""
    simulation, controller, walker = simulated(robot, {"walking.lowering": lowering})
    nominal, heights = controller.dynamics.com[2], []
    for _ in range(2):
        controller.walk(0.0)
        simulation.run(0.9)
        controller.stand()
        simulation.run(2.2)
        assert walker.phase is Phase.STAND
        heights.append(controller.dynamics.com[2])
    np.testing.assert_allclose(heights, nominal - lowering, atol=0.006)


@pytest.mark.parametrize(("robot", "forward", "kick", "most"), [("g1", 0.0, 0.5, 0.012), ("go2", 0.8, 0.0, 0.004)])
def test_the_height_remains_during_fast_motion(robot, forward, kick, most):
    """Of the centre of mass. G1 rises by 8.7 mm, Go2 sinks by 2.9 mm; with half the weight by 18 and 5.1 mm."""
    simulation, _, _ = walking(robot, forward, seconds=1.2)
    q, v = simulation.plant.state()
    simulation.plant.set_state(q, np.concatenate([[v[0] + kick], v[1:]]))
    before, heights = simulation.controller.dynamics.com[2], []
    simulation.run(1.5, lambda now: heights.append(now.controller.dynamics.com[2]))
    assert np.abs(np.array(heights) - before).max() < most


def test_a_fast_robot_stops_within_three_steps_before_it_is_deactivated():
    """Asked just before a touchdown, which counts as the first step. Meanwhile it refuses commands to walk."""
    simulation, controller, walker = walking("g1", 0.8, seconds=3.8, changes={"walking.max_speed": 0.8})
    phases = []
    while walker.phase is not Phase.SINGLE or simulation.time - walker._since < walker._step.landing.time - 0.06:
        simulation.run(0.002)
    before = walker.steps
    controller.request("deactivate")
    controller.walk(0.2)
    results = simulation.run(0.01)
    assert any("refused" in sentence for result in results for sentence in result.refused)
    with pytest.raises(NoSolution, match="inactive"):  # the simulation ends with the active mode
        simulation.run(8.0, lambda now: phases.append((walker.phase, now.result.mode)))
    assert {mode for _, mode in phases} == {wbc.Mode.ACTIVE}
    assert (phases[-1][0], walker.phase) == (Phase.STOP, Phase.STAND)
    assert walker.steps - before <= 3
    assert not simulation.plant.fallen


def stepping_g1(elapsed):
    """Return a simulation of G1 that steps in place, after a time in the swing of the right foot, and its walker."""
    simulation, controller, walker = simulated("g1")
    controller.walk(0.0)
    while walker.steps < 1 or walker.phase is not Phase.SINGLE:
        simulation.run(0.002)
    simulation.run(elapsed)
    return simulation, walker


@pytest.mark.parametrize("kick", [-0.5j, 0.7j])
def test_a_stepping_robot_survives_a_change_of_its_velocity(kick):
    """The right foot cannot follow an outward change, to the left."""
    simulation, walker = stepping_g1(0.1)
    simulation.plant.data.qvel[:2] += [complex(kick).real, complex(kick).imag]
    simulation.run(2.0)
    start, _ = simulation.plant.state()
    simulation.run(1.2)
    assert walker.phase in (Phase.SINGLE, Phase.DOUBLE)
    moved = simulation.plant.state()[0][:2] - start[:2]
    assert np.abs(moved).max() < 0.2  # about 0.1 m of sway


def test_a_foot_that_lands_after_an_outward_push_steps_again():
    """One wide step of the right foot stops the robot, and the next step takes its nominal time."""
    simulation, walker = stepping_g1(0.36)
    simulation.plant.data.qvel[1] -= 0.5
    swings, stance = [], walker._stance
    simulation.run(1.1, lambda _: swings.append((walker.phase, walker._stance, walker._since)))
    begun = [swing for i, swing in enumerate(swings) if swing[0] is Phase.SINGLE and swing not in swings[:i]]
    assert [side for _, side, _ in begun[:4]] == [stance, stance, -stance, stance]
    assert begun[3][2] - begun[2][2] > 0.9 * walker.gait.step_time


@pytest.mark.parametrize(("planned", "kick"), [("this step", 0.5), ("the next step", 0.5), ("nothing", 1.0)])
def test_a_foot_does_not_step_again_before_a_planned_step_of_the_other_foot_or_out_of_reach(planned, kick):
    simulation, walker = stepping_g1(0.36)
    simulation.plant.data.qvel[1] -= kick
    walker._step.begun = replace(walker._step.begun, planned=planned == "this step")
    steps = walker.steps
    if planned == "the next step":
        walker.footsteps = (Footstep(walker._stance, walker._step.landing.place + 0.2j * walker._stance, 0.0),)
    while walker.phase is Phase.SINGLE:
        begun = walker._since
        simulation.run(0.002)
        assert walker.phase is not Phase.SINGLE or walker._since == begun
    assert walker.steps == steps + 1


@pytest.mark.parametrize(("unevenness", "beyond"), [(0.0, True), (0.01, False)])
def test_trunk_and_arms_help_after_an_outward_push_on_even_ground(unevenness, beyond):
    """The demanded centre of pressure leaves the sole, unless an edge may support it."""
    simulation, walker = stepping_g1(0.1)
    simulation.plant.data.qvel[1] += 0.5
    walker._roughness.unevenness, margins = unevenness, []
    simulation.run(0.06, lambda _: margins.append(walker.plan().margin))
    assert (min(margins) < -0.05) is beyond
    assert (min(margins) < 0.0) is beyond


def test_a_pushed_robot_keeps_its_knees_bent():
    """A higher centre of mass helps to stop the DCM, but straight legs cannot swing."""
    simulation, _ = stepping_g1(0.08)
    controller, plant = simulation.controller, simulation.plant
    force = -4.5 * controller.model.mass
    plant.push(controller.model.base_link, [force, -force, 0.0, 0.0, 0.0, 0.0], 0.1)
    knees = [controller.model.joints.index(f"{side}_knee_joint") for side in ("left", "right")]
    bends = []
    simulation.run(1.5, lambda now: bends.append(now.result.state.q[controller.model.q_index[knees]]))
    assert np.min(bends) > 0.2


@pytest.mark.parametrize("on_the_ground", [False, True])
def test_a_touchdown_counts_only_near_the_ground(monkeypatch, on_the_ground):
    """A sensor that always reports a touchdown ends a swing in the lower half of the clearance.

    `on_the_ground`: the walker believes that the reference is there; the foot follows the true one.
    """
    monkeypatch.setattr("wbc_controller.walking.touchdown.lands", lambda *others: others[-2])
    monkeypatch.setattr(BipedWalker, "_sensor", lambda *_: True)
    swung, motions = Foot.swung, []

    def lowered(foot, swing, landing, *others):
        before = motions[-1][1] if motions and motions[-1][0] is swing else swing
        motion, *found = swung(foot, before, landing, *others)
        believed = motion.copy()
        believed[0, 2] = landing.height
        motions.append((believed, motion))
        return believed, *found

    if on_the_ground:
        monkeypatch.setattr(Foot, "swung", lowered)
    simulation, controller, walker = simulated("g1")
    heights = []  # above the planned touchdown, as shares of the clearance

    def look(robot):
        if walker.phase is Phase.SINGLE:
            (contact,) = set(robot.controller.contacts) - set(robot.result.solution.forces)
            height, landing = robot.plant.foot_placement(contact).translation[2], walker._step.landing
            heights.append((height - landing.height) / walker.gait.clearance_on(landing.roughness))
        elif heights:
            assert heights[-1] < 0.55 < max(heights)
            heights.clear()

    controller.walk(0.0)
    simulation.run(2.1, look)
    assert walker.steps >= 2


@pytest.mark.parametrize(("low", "rest"), [(1.0, 0.02), (0.0, 0.04)])
def test_a_foot_that_stops_in_the_air_has_landed_after_some_rest(monkeypatch, low, rest):
    """A sole on a stone rests above the lower half of the clearance."""
    stopped = []
    monkeypatch.setattr("wbc_controller.walking.touchdown._LOW", low)
    monkeypatch.setattr("wbc_controller.walking.touchdown._AT_REST", math.inf)  # it swings
    monkeypatch.setattr("wbc_controller.walking.touchdown.lands", lambda *_: bool(stopped))
    simulation, controller, walker = simulated("g1")
    controller.walk(0.0)
    run_to(simulation, Phase.SINGLE)
    simulation.run(0.6 * walker.gait.single)  # the foot is high
    stopped.append(True)
    simulation.run(0.01)
    assert walker.phase is Phase.SINGLE
    stopped.clear()
    simulation.run(0.01)
    stopped.append(True)
    simulation.run(rest - 0.004)
    assert walker.phase is Phase.SINGLE
    simulation.run(0.01)
    assert walker.phase is Phase.DOUBLE


def touchdown_delay(monkeypatch, **replaced):
    """Return the time of a touchdown after the planned one, s, with some names of the walker replaced."""
    for name, value in replaced.items():
        monkeypatch.setattr(f"wbc_controller.walking.touchdown.{name}", value)
    simulation, walker = stepping_g1(0.0)
    begun = walker._since
    while walker.phase is Phase.SINGLE:
        planned = walker._step.landing.time
        simulation.run(0.002)
    return walker._since - begun - planned


def test_a_foot_that_moves_high_above_the_ground_has_not_landed(monkeypatch):
    """Limited torques slow a foot down in the air."""
    assert touchdown_delay(monkeypatch, _LOW=0.0, lands=lambda *_: True) > -0.02


def test_a_late_foot_has_landed_at_any_height(monkeypatch):
    delay = touchdown_delay(monkeypatch, _HIGHER=-1.0, lands=lambda late, *_: late >= LATEST)
    assert delay == pytest.approx(LATEST, abs=0.005)


def tracking_errors(filtered, *, reaction=1.0, lag=1.0):
    """Return mean distances of DCM and swing foot to their references in single support, m, at 0.4 m/s."""
    simulation, controller, walker = simulated("g1", {"estimation.torque_filter": filtered})
    errors = []
    walker.gait = replace(walker.gait, reaction=reaction * walker.gait.reaction)
    walker._lag *= lag

    def look(_):
        if simulation.time > 1.8 and walker.phase is Phase.SINGLE:
            dcm, foot = walker._latest[0].dcm, walker._feet[-walker._stance]
            distance = foot.sole(controller.dynamics).place - complex(*walker._step.swing[0, :2])
            errors.append((abs(dcm - walker._dcm_wanted), abs(distance)))

    controller.walk(0.4)
    simulation.run(3.0, look)
    return np.mean(errors, axis=0)


@pytest.mark.parametrize(
    ("filtered", "without", "quantity"), [("never", {"reaction": 0.0}, 0), ("always", {"lag": 0.0}, 1)]
)
def test_dcm_and_swing_foot_follow_their_references(filtered, without, quantity):
    """The references contain the reaction of the swing foot and the lag of filtered torques."""
    assert tracking_errors(filtered)[quantity] < 0.6 * tracking_errors(filtered, **without)[quantity]


def test_the_reference_of_the_dcm_does_not_jump_after_lift_off():
    """At the first lift-off, the shift of the weight ends 19 mm from the reference of the step."""
    simulation, controller, walker = simulated("g1")
    references = []

    def look(_):
        if walker.phase is Phase.SINGLE:
            references.append(walker._dcm_wanted)

    controller.walk(0.4)
    simulation.run(1.0, look)
    assert len(references) > 50
    assert np.abs(np.diff(references)).max() < 0.002


def test_the_planned_touchdown_is_frozen_before_the_foot_lands():
    """In the last 0.05 s, noise of the ground's height would need large accelerations."""
    simulation, controller, walker = simulated("g1")
    controller.walk(0.3)
    frozen = {}
    for _ in range(1300):
        simulation.run(0.002)
        step = walker._step
        if walker.phase is Phase.SINGLE and step.landing.time - (simulation.time - walker._since) < 0.045:
            frozen.setdefault(walker.steps, []).append(step.landing)
    frozen.pop(walker.steps, None)  # not landed yet
    assert len(frozen) >= 2
    for landings in frozen.values():
        assert len(landings) >= 4
        assert all(landing is landings[0] for landing in landings)


@pytest.mark.parametrize(
    ("robot", "ask"),
    [
        ("g1", lambda controller: controller.walk_to(1.0, 0.2, 0.3)),
        ("g1", lambda controller: controller.walk_footsteps([[0.1, 0.1, 0.0], [0.2, -0.1, 0.0], [0.3, 0.1, 0.0]])),
        ("go2", lambda controller: controller.walk(0.4, 0.1, 0.5)),
    ],
)
def test_a_walk_continues_exactly_from_a_saved_state(robot, ask):
    """Walks of G1 by a velocity: `test_walking_replay.py`."""
    simulation, controller, walker = simulated(robot)
    states = []
    ask(controller)
    simulation.run(0.8)
    run_to(simulation, Phase.SINGLE)
    saved = from_json(to_json(controller.memory()))
    results = simulation.run(0.65, lambda now: states.append((now.result.state, now.result.time)))
    assert walker.steps >= 1
    other = wbc.Controller(controller.config)
    other.reset(states[0][0].q, states[0][0].v, states[0][1])
    other.recall(saved, controller.config.settings)
    for result, (state, time) in zip(results, states, strict=True):
        assert np.array_equal(other.step(state.q, state.v, time).tau, result.tau)


def walk_with_sensors(sensors, seconds):
    """Return the torques of G1 and the share of the swing at each touchdown; `sensors` returns states of sensors."""
    simulation, controller, walker = simulated("g1")
    cycle, torques, shares = controller.cycle, [], []

    def share(now):
        return (now - walker._since) / walker._step.landing.time if walker.phase is Phase.SINGLE else 0.0

    def sensed(inputs):
        before = share(inputs.now)
        result = cycle(replace(inputs, touching=sensors(walker, before)))
        if before > 0.0 and walker.phase is Phase.DOUBLE:
            shares.append(before)
        torques.append(result.tau)
        return result

    controller.cycle = sensed
    controller.walk(0.2)
    simulation.run(seconds)
    return torques, shares


def test_a_contact_sensor_tells_the_touchdown():
    """It must show the foot in the air before: a jammed sensor changes nothing."""

    def early(walker, share):
        return {walker._feet[-walker._stance].contact: share >= 0.9}

    torques, shares = walk_with_sensors(lambda walker, share: {}, 1.7)
    assert min(shares) > 0.95
    jammed, _ = walk_with_sensors(lambda walker, share: {"left_foot": True, "right_foot": True}, 1.7)
    assert all(np.array_equal(a, b) for a, b in zip(torques, jammed, strict=True))
    _, shares = walk_with_sensors(early, 2.1)
    assert len(shares) >= 2
    assert 0.9 <= shares[0] < 0.91  # in the air: the robot then leans on this foot, and the next ones land sooner
    assert max(shares) < 0.91


def test_force_sensors_of_the_robot_reach_the_walker(short_rest):
    changes = {**short_rest, "estimation.base_state": "imu", "mock.sensors": "good"}
    trial = EstimationTrial("g1", changes, force_sensors=True)
    trial.settle()
    assert trial.report.inputs.touching == {"left_foot": True, "right_foot": True}


def test_a_walk_survives_short_holding_in_single_support():
    """Cycles without a solution repeat the last torques, with damping."""
    simulation, controller, walker = walking("g1", 0.3, seconds=1.6)
    plant, solve = simulation.plant, controller.qp.solve
    while walker.phase is not Phase.SINGLE or simulation.time - walker._since < 0.2:
        simulation.run(0.002)

    def fail(*_):
        raise NoSolution("none", "test", None)

    controller.qp.solve = fail
    for _ in range(25):
        result = controller.step(*plant.state(), plant.time)
        assert result.mode is wbc.Mode.HOLDING
        plant.apply(result.tau)
        simulate(plant, plant.steps_per_period)
    controller.qp.solve = solve
    simulation.run(1.2)
    assert walker.phase in (Phase.SINGLE, Phase.DOUBLE)


def test_a_streamed_command_ends_after_its_timeout():
    simulation, controller, walker = simulated("go2")
    for _ in range(3):
        controller._command(Walk(np.array([0.2, 0.0, 0.0]), streamed=True))
        simulation.run(0.4)
    assert walker.phase in (Phase.SINGLE, Phase.DOUBLE)
    simulation.run(1.6)
    assert walker.phase is Phase.STAND
    assert controller.mode is wbc.Mode.ACTIVE


def standing(bench):
    return bench("g1", {"safety": {"activation_ramp": 0.01}}).activated(20)


def test_a_goal_and_footsteps_by_topic(bench, make):
    controller = standing(bench)
    walker = controller.loop.controller.walker
    controller.send("walk_goal", make.pose([1.0, 0.5, 0.0], [0.0, 0.0, np.sin(0.2), np.cos(0.2)]))
    report = controller.cycle(2)
    assert not report.refused
    assert walker.goal == Goal(1.0 + 0.5j, pytest.approx(0.4))
    controller.send("walk_footsteps", make.pose_array([[0.1, 0.12, 0.0], [0.2, -0.12, 0.1]]))
    report = controller.cycle(2)
    assert not report.refused
    assert (walker.goal, walker.footsteps_left) == (None, 2)
    assert [left.data for left in controller.received("walk_footsteps_left")] == [0, 2]
    controller.send("walk_footsteps", make.pose_array([[9.0, 0.12, 0.0]]))
    report = controller.cycle(2)
    assert any("step 1 of 1" in sentence for each in controller.reports[-2:] for sentence in each.refused)
    assert walker.footsteps_left == 2
    controller.send("cmd_vel", make.velocity("cmd_vel", [0.0] * 6))
    controller.cycle(2)
    assert [left.data for left in controller.received("walk_footsteps_left")] == [0, 2, 0]
    assert walker.command is None


@pytest.mark.parametrize("key", ["cmd_vel", "cmd_vel_stamped"])
def test_a_velocity_by_topic_starts_the_walk_and_ends_the_watch_of_the_bring_up(bench, make, key):
    controller, compared = standing(bench), []
    watch = SimpleNamespace(fault=None, check=lambda state, dynamics, solution, *_: compared.append(solution))
    controller.loop._bring_up = watch
    controller.cycle()
    assert compared[0] is not None
    controller.send(key, make.velocity(key, [0.2, 0.0, 0.0, 0.0, 0.0, 0.1]))
    report = controller.cycle(2)
    walker = controller.loop.controller.walker
    assert not report.refused
    assert walker.phase is Phase.SHIFT
    assert walker.command == Velocity(0.2, 0.1)
    assert compared[-1] is None


def test_only_robots_that_walk_have_the_topic_of_the_velocity(robot_of):
    settings, model = robot_of("go2")
    for section, keys in ((settings.walking, set(WALKING_KEYS)), (None, set())):
        endpoints = controller_endpoints(settings.model_copy(update={"walking": section}), model)
        assert {endpoint.key for endpoint in endpoints} & set(WALKING_KEYS) == keys


@pytest.mark.parametrize(("word", "mode"), [("damp", wbc.Mode.DAMPING), ("estop", wbc.Mode.FAULT)])
def test_damp_and_estop_do_not_wait_for_the_gait(word, mode):
    controller = wbc.Controller("g1")
    q, v = controller.stance(), np.zeros(controller.model.nv)
    controller.reset(q, v)
    controller.walk(0.3)
    controller.step(q, v, 0.002)
    assert controller.walker.moves
    controller.request(word)
    assert controller.step(q, v, 0.004).mode is mode
    controller.reset(q, v, 0.006)
    assert not controller.walker.moves


@pytest.mark.parametrize(
    ("robot", "call", "message"),
    [
        ("g1", lambda controller: controller.walk(np.nan), "walking velocity"),
        ("g1", lambda controller: controller.walk(np.inf), "walking velocity"),
        ("g1", lambda controller: controller.walk_to(np.nan, 0.0, 0.0), "the goal is not finite"),
        ("g1", lambda controller: controller.walk_footsteps([[1.0, 2.0]]), "the footsteps have the shape"),
        (wbc.load("go2").replace({"walking": None}), lambda controller: controller.walk(0.1), "no section 'walking'"),
    ],
)
def test_invalid_commands_and_robots_without_the_section_are_refused(robot, call, message):
    controller = wbc.Controller(robot)
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    assert message in input_refusal(call, controller)
