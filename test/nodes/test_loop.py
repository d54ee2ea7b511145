"""The loop: order of a cycle, ages and deadlines, and resulting modes."""

import dataclasses
import itertools
import re
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from waiting import running

from wbc_controller.errors import NoSolution
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.records import Mode

TIMEOUT = 0.05


def test_activation_is_refused_until_the_inputs_are_fresh(bench):
    controller = bench()
    controller.command("activate")
    (sentence,) = controller.cycle(joints=False, base=False).refused
    assert sentence == (
        "command 'activate' is refused: joint_states has not arrived (limit 50 ms); odom has not arrived (limit 50 ms)"
    )
    assert sentence in controller.status.message
    controller.command("activate")
    assert "odom has not arrived" in controller.cycle(base=False).refused[0]
    assert controller.activate().mode is Mode.ACTIVE


@pytest.mark.parametrize(("silent", "name"), [({"joints": False}, "joint_states"), ({"base": False}, "odom")])
def test_an_input_is_stale_one_cycle_after_the_timeout(bench, silent, name):
    controller = bench().activated(10)
    count = round(TIMEOUT / controller.period)
    for i in range(1, count):
        report = controller.cycle(**silent)
        assert report.mode is Mode.ACTIVE
        assert report.inputs.ages[name] == pytest.approx(i * controller.period)
    report = controller.cycle(2, **silent)
    assert report.mode is Mode.DAMPING
    assert report.inputs.ages[name] <= TIMEOUT + controller.period + 1e-9
    assert report.fault.code == "STALE_INPUT"
    assert report.fault.sentence in (f"{name} is 52 ms old (limit 50 ms)", f"{name} is 50 ms old (limit 50 ms)")
    assert controller.received("state")[-1].data == f"damping STALE_INPUT: {report.fault.sentence}"


def test_damping_opposes_fresh_velocities_and_lets_stale_ones_sink(bench):
    controller = bench(changes={"safety": {"damping": 3.0, "damping_time": 0.3}}).activated(120)
    controller.v[controller.model.v_index] = 0.5
    report = controller.cycle(60, base=False)
    assert report.mode is Mode.DAMPING
    np.testing.assert_allclose(report.command.tau, -1.5)
    assert np.isnan(report.command.q_desired).all()
    report = controller.cycle(40, base=False, joints=False)
    assert not report.command.tau.any()
    report = controller.cycle(120, base=False, joints=False)
    assert report.mode is Mode.FAULT
    assert report.fault.code == "STALE_INPUT"
    controller.command("reset")
    controller.v[:] = 0.0  # at rest, by its positions
    assert controller.cycle().mode is Mode.INACTIVE
    assert controller.activate().mode is Mode.ACTIVE


def divide_by_zero(*arguments):
    raise ZeroDivisionError("division by zero")


def press_at_most(controller, monkeypatch, force):
    """Limit the normal force of a foot, N; below zero the program is infeasible."""
    monkeypatch.setattr(controller.loop.controller.qp.contacts["front_left_foot"], "max_normal_force", force)


def searched(controller):
    """Wait for the concurrent search."""
    controller.loop.controller._explanation._search.result()


def test_a_failure_is_explained_once_and_the_explanation_stays(bench, monkeypatch, caplog):
    safety, often = {"damping_time": 0.1, "hold_time": 0.05}, {"diagnostics_rate": 100.0}
    controller = bench(changes={"safety": safety, "control": often}).activated(120)
    press_at_most(controller, monkeypatch, -50.0)
    searches = []

    def search(failure):
        searches.append(threading.current_thread())
        return explained(failure)

    explained = NoSolution.explained
    monkeypatch.setattr(NoSolution, "explained", search)
    sent = controller.efforts()
    report = controller.cycle()
    assert (report.mode, report.fault.code, report.fault.infeasibility) == (Mode.HOLDING, "NO_SOLUTION", None)
    assert sent[-1].any()
    np.testing.assert_array_equal(controller.efforts(), [*sent, sent[-1]])
    searched(controller)
    report = controller.cycle()
    why = report.fault.infeasibility
    assert set(why.conflict) == {"normal_force:front_left_foot", "cone:front_left_foot"}
    assert report.fault.sentence.endswith(why.sentence)
    assert why.sentence in controller.received("state")[-1].data
    assert why.sentence in caplog.text
    for mode, count in ((Mode.HOLDING, 20), (Mode.DAMPING, 10), (Mode.FAULT, 60)):
        report = controller.cycle(count)
        assert (report.mode, report.fault.infeasibility) == (mode, why)
        assert why.sentence in controller.status.message
    assert not report.command.tau.any()
    assert len(searches) == 1
    assert searches[0] is not threading.current_thread()  # the loop continues meanwhile


def test_a_failure_that_is_over_is_explained_as_it_was(bench, monkeypatch, caplog):
    controller = bench().activated(120)
    release, explained = threading.Event(), NoSolution.explained
    monkeypatch.setattr(NoSolution, "explained", lambda failure: release.wait(60.0) and explained(failure))
    press_at_most(controller, monkeypatch, -50.0)
    assert controller.cycle().mode is Mode.HOLDING
    press_at_most(controller, monkeypatch, 400.0)
    sent = len(controller.efforts())
    assert controller.cycle(5).mode is Mode.ACTIVE
    assert len(controller.efforts()) == sent + 5  # the search does not block the loop
    release.set()
    searched(controller)
    report = controller.cycle()
    assert (report.mode, report.fault) == (Mode.ACTIVE, None)
    assert "normal force of front_left_foot" in caplog.text


def test_a_search_that_fails_is_logged_and_the_fault_stays(bench, monkeypatch, caplog):
    controller = bench().activated(120)
    press_at_most(controller, monkeypatch, -50.0)

    monkeypatch.setattr(NoSolution, "explained", divide_by_zero)
    controller.cycle()
    with pytest.raises(ZeroDivisionError):
        searched(controller)
    report = controller.cycle()
    assert (report.mode, report.fault.code, report.fault.infeasibility) == (Mode.HOLDING, "NO_SOLUTION", None)
    assert "division by zero" in caplog.text


def test_failures_that_come_and_go_are_explained_once_a_second(bench, monkeypatch):
    controller = bench(changes={"control": {"rate": 100.0}}).activated(30)
    explained, searches = NoSolution.explained, []
    monkeypatch.setattr(NoSolution, "explained", lambda failure: searches.append(1) or explained(failure))
    for i in range(200):  # two seconds
        fails = i % 40 == 1  # less often than the budget of holding allows
        press_at_most(controller, monkeypatch, -50.0 if fails else 400.0)
        assert controller.cycle().mode is (Mode.HOLDING if fails else Mode.ACTIVE)
        if controller.loop.controller._explanation._search is not None:
            searched(controller)
    assert len(searches) == 2


@pytest.mark.parametrize("where", ["solve", "sample", "apply", "reset"])
def test_an_exception_inside_becomes_a_fault_and_is_logged(bench, monkeypatch, caplog, make, where):
    controller = bench()
    controller.cycle(3) if where == "reset" else controller.activated(10)
    owner = controller.loop.controller.qp if where == "solve" else controller.loop.controller.board
    monkeypatch.setattr(owner, where, divide_by_zero)
    if where == "reset":  # while it starts
        report = controller.activate()
        assert not report.command.tau.any()
    else:
        controller.send("weight", make.float64(1.0), "com")
        report = controller.cycle()
    assert report.mode is Mode.DAMPING
    assert (report.fault.code, report.fault.sentence) == ("INTERNAL_ERROR", "ZeroDivisionError: division by zero")
    assert "Traceback" in caplog.text
    controller.cycle(10)
    assert np.isfinite(controller.efforts()).all()


def zeros_on_joint_states(controller):
    nothing = np.zeros(controller.model.nj)
    controller.joints(position=nothing, velocity=nothing)


def odometry_that_spins(controller):
    controller.base(twist=[0.0, 0.0, 0.0, 627.0, 0.0, 0.0])


@pytest.mark.parametrize(("sample", "key"), [(zeros_on_joint_states, "joint_states"), (odometry_that_spins, "odom")])
def test_single_implausible_samples_are_rejected_and_counted_and_a_sequence_damps(bench, sample, key):
    controller = bench().activated(120)
    torques = controller.reports[-1].command.tau
    for _ in range(2):
        for _ in range(2):
            controller.give_state(joints=key != "joint_states", base=key != "odom")
            sample(controller)
            report = controller.loop.cycle()
            (sentence,) = report.refused
            assert sentence.startswith(f"/{key}: ")
            assert (report.mode, report.fault) == (Mode.ACTIVE, None)
            np.testing.assert_allclose(report.command.tau, torques, atol=0.5)
        controller.cycle(20)
    controller.cycle(110)
    assert controller.values[f"rejected/{key}"] == "4"
    for _ in range(3):
        controller.give_state(joints=key != "joint_states", base=key != "odom")
        sample(controller)
        report = controller.loop.cycle()
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "IMPLAUSIBLE_STATE")
    assert report.fault.sentence.startswith(f"/{key}: 3 consecutive messages rejected: ")


def test_several_publishers_of_joint_states_are_on_diagnostics_and_in_the_reason_of_a_refusal(bench):
    controller = bench().activated(20)
    second = MemoryTransport(controller.bus, "gui")
    for topic in controller.topics:
        if topic.key == "joint_states":
            second.advertise(counterpart(topic))
    controller.cycle(190)  # the graph is checked four times per second
    assert controller.status.level == 0
    assert controller.values["publishers//joint_states"] == "/gui, /memory"
    controller.give_state(joints=False)
    zeros_on_joint_states(controller)
    (sentence,) = controller.loop.cycle().refused
    assert re.search(r"jumps by .*; /joint_states has several publishers: .*/gui", sentence)


def test_an_extreme_request_is_refused_with_its_range(bench, make):
    """In the task's own frame; other requests: `test_invalid_calls`."""
    controller = bench().activated(20)
    board = controller.loop.controller.board
    before = board._trajectories["com"]
    controller.send("setpoint", make.point([0.0, 50.0, 0.0], "com/reference"), "com")
    (sentence,) = controller.cycle().refused
    assert re.search(r" is .*; for this robot it must be from -?[\d.]+ to [\d.]+", sentence)
    assert controller.cycle().mode is Mode.ACTIVE
    assert board._trajectories["com"] is before


def test_commands_to_an_inactive_controller_are_refused_in_words(bench, make):
    controller = bench()
    controller.cycle()
    controller.send("weight", make.float64(1.0), "com")
    controller.send("setpoint", make.point([0, 0, 0.3]), "com")
    report = controller.cycle()
    assert report.refused == ("2 task or contact commands: the controller is inactive; send 'activate' first",)
    controller.cycle(5)  # finish pending diagnostics first
    assert report.refused[0] in controller.status.message


def test_commands_in_the_cycle_of_the_activation_or_of_a_failure_are_not_lost(bench, make):
    controller = bench()
    controller.command("activate")
    controller.send("contact_enable", make.bool(False), "front_left_foot")
    report = controller.cycle()
    assert not report.refused
    controller.cycle(110)
    assert "front_left_foot" not in controller.reports[-1].solution.forces
    controller = bench().activated()
    said = "1 task or contact commands: the controller is damping; send 'reset' and 'activate' first"
    for _ in range(30):
        controller.send("weight", make.float64(1.0), "com")
        report = controller.cycle(base=False)
        assert report.refused == (() if report.mode is Mode.ACTIVE else (said,))
    assert report.mode is Mode.DAMPING


def test_references_follow_the_clock_of_the_states(bench, monkeypatch):
    controller, taken = bench().activated(3), []
    board = controller.loop.controller.board
    monkeypatch.setattr(board, "sample", lambda time, sample=board.sample: taken.append(time) or sample(time))
    controller.cycle()
    assert taken == [controller.time * 1e-9]


@pytest.mark.parametrize(
    ("costs", "starts", "missed"),
    [
        ([0.1, 0.2, 0.05, 0.2499], [0.25 * i for i in range(8)], 0),
        ([0.1, 0.3, 0.1, 0.8, 0.1], [0.0, 0.25, 0.75, 1.0, 2.0, 2.25, 2.5, 2.75], 1 + 3),
    ],
)
def test_the_timer_keeps_absolute_deadlines_and_counts_lateness(bench, monkeypatch, costs, starts, missed):
    controller, began, durations = bench(), [], iter(costs)
    clock, loop = controller.clock, controller.loop

    def cycle():
        began.append(clock.time)
        clock.time += next(durations, 0.0)

    def wait(seconds):
        clock.time += seconds

    monkeypatch.setattr(loop, "cycle", cycle)
    clock.time, loop.period, loop.triggered = 0.0, 0.25, False
    loop.run(SimpleNamespace(is_set=lambda: clock.time >= starts[-1] + 0.25, wait=wait))
    assert began == starts
    assert loop._deadlines_missed == missed


@pytest.mark.parametrize("active", [True, False])
def test_the_end_of_the_loop_leaves_no_torque(bench, active):
    controller = bench()
    if active:
        controller.activate()
        controller.cycle(20)
        assert controller.efforts()[-1].any()
    before = len(controller.received("effort"))
    stop = threading.Event()
    stop.set()
    controller.loop.triggered = True
    controller.loop.run(stop)
    efforts = controller.efforts()[before:]
    assert len(efforts) == active
    assert not efforts.any()
    assert controller.received("state")[-1].data == ("stopped" if active else "inactive")


@pytest.mark.parametrize("where", ["supervisor", "publish", "inputs", "observer"])
def test_a_loop_in_which_something_fails_sends_zeros_and_damps_with_a_fault(bench, monkeypatch, where):
    """After any exception around the controller the process continues, from zero torques."""
    controller = bench(changes={"limits": {"torque_rate": 10.0}}).activated(120)
    assert controller.efforts()[-1].any()
    loop, stop = controller.loop, threading.Event()
    owner = {"supervisor": loop.controller.supervisor, "inputs": loop._inputs}.get(where, loop._outputs)
    name = {"supervisor": "step", "inputs": "latch", "publish": "publish_command", "observer": "publish_report"}[where]
    whole, calls = getattr(owner, name), []

    def broken(*arguments, **named):
        calls.append(len(controller.efforts()))
        if len(calls) == 1:
            raise MemoryError("none left")
        if len(calls) == 3:
            stop.set()
        return whole(*arguments, **named)

    monkeypatch.setattr(owner, name, broken)
    controller.joints()
    controller.base()
    loop.period, loop.triggered = 1e-4, False
    loop.run(stop)
    efforts = controller.efforts()[calls[0] :]
    assert not efforts[: calls[1] - calls[0]][0].any()  # zeros before the next cycle
    step = controller.settings.limits.torque_rate * controller.period * controller.model.effort_limits
    zeros = int((~efforts.any(axis=1)).argmax())
    assert (np.abs(np.diff(efforts[zeros:], axis=0)) <= step + 1e-9).all()
    damped = [report for report in controller.reports if report.mode is Mode.DAMPING]
    assert damped[0].fault.code == "INTERNAL_ERROR"
    assert damped[0].fault.sentence == "MemoryError: none left"


@pytest.mark.parametrize(("filtered", "share"), [("never", 1.0), ("always", 0.33)])
def test_solutions_use_the_torque_rate_and_a_share_of_it_with_a_torque_filter(bench, make, filtered, share):
    changes = {"limits": {"torque_rate": 1.0}, "estimation": {"torque_filter": filtered}}
    controller = bench(changes=changes | {"tasks": {"com": {"setpoint_duration": 0.0}}}).activated(800)
    before = len(controller.efforts())
    controller.send("setpoint", make.point([0.1, 0.0, 0.4]), "com")
    controller.cycle(5)
    step = controller.settings.limits.torque_rate * controller.period * controller.model.effort_limits
    efforts = controller.efforts()[before - 1 :]
    assert np.max(np.abs(np.diff(efforts, axis=0)) / step) == pytest.approx(share, rel=1e-6)
    solved = np.array([report.solution.tau for report in controller.reports[-5:]])
    passed = 1.0 if filtered == "never" else -np.expm1(-controller.period / 0.008)
    assert np.max(np.abs(solved - efforts[:-1]) / step) == pytest.approx(share / passed, rel=1e-6)


def test_a_triggered_loop_waits_until_states_are_stale(bench):
    controller = bench()
    patience, controller.loop.period = controller.loop._wait_time, 0.002
    assert patience() == 0.002  # no joint states yet
    controller.joints()
    controller.loop.cycle()
    assert patience() == pytest.approx(TIMEOUT)
    controller.clock.time += 0.03
    assert patience() == pytest.approx(0.02)
    controller.clock.time += 0.1
    assert patience() == 0.002


def test_each_joint_state_starts_one_cycle(bench):
    controller, stop, began = bench(), threading.Event(), threading.Event()
    controller.loop.period, controller.loop.triggered = 0.5, True
    controller.loop.observers = (lambda report: began.set(), controller.reports.append)
    with running(controller.loop.run, stop, stop=stop.set):
        assert began.wait(5)  # the first message without a state
        for _ in range(10):
            began.clear()
            controller.give_state()
            assert began.wait(5)
    assert len({report.stamp for report in controller.reports if report.stamp}) == 10


def rival_of(controller, name="wbc_controller"):
    """Another node that publishes torques."""
    rival = MemoryTransport(controller.bus, name)
    rival.advertise(next(topic for topic in controller.topics if topic.key == "effort"))
    return rival


def test_while_another_node_publishes_torques_activation_is_refused(bench):
    controller = bench()
    rival = rival_of(controller)
    report = controller.activate()
    assert report.mode is Mode.INACTIVE
    (sentence,) = report.refused
    assert sentence.startswith(
        "command 'activate' is refused: torques on /effort_controller/commands are published by /wbc_controller too"
    )
    status = controller.status
    assert status.level == 1
    assert "published by /wbc_controller too" in status.message
    rival.close()
    controller.cycle(130)
    assert controller.activate().mode is Mode.ACTIVE
    rival_of(controller, "guard")
    controller.cycle(130)
    assert controller.status.level == 0


def test_a_second_publisher_of_torques_is_reported_under_control(bench, caplog):
    controller = bench(changes={"control": {"diagnostics_rate": 0.1}}).activated(60)
    said = len(controller.received("diagnostics"))
    rival_of(controller, "stranger")
    assert controller.cycle(round(0.25 / controller.period) + 1).mode is Mode.ACTIVE  # the period of the checks
    assert len(controller.received("diagnostics")) == said + 1
    status = controller.status
    assert (status.level, "published by /stranger too" in status.message) == (2, True)
    assert "published by /stranger too" in caplog.text
    assert controller.cycle(130).mode is Mode.ACTIVE
    controller.command("damp")  # all other requests are executed
    assert controller.cycle().mode is Mode.DAMPING


def test_the_activation_at_the_start_waits_until_the_robot_has_no_other_owner(bench, caplog):
    controller = bench()
    controller.loop._activate_when_fresh = True
    rival = rival_of(controller)
    assert controller.cycle(130).mode is Mode.INACTIVE
    assert sum("the activation at the start waits: torques on" in said for said in caplog.messages) == 1
    rival.close()
    assert controller.cycle(130).mode is Mode.ACTIVE


def test_a_fault_is_logged_once_for_as_long_as_it_lasts(bench, caplog):
    caplog.set_level("INFO", "wbc_controller")
    controller = bench(changes={"safety": {"damping_time": 0.2, "activation_ramp": 0.1}}).activated(5)
    controller.command("deactivate")
    controller.cycle(100)
    controller.activate()
    controller.cycle(30, joints=False, base=False)
    controller.cycle(700)  # damping, and 1.2 s of the fault
    controller.request("reset")
    said = [re.sub("is .*", "is …", said) for said in caplog.messages if not said.startswith("scheduling")]
    assert "; ".join(said) == (
        "command 'activate' accepted; mode: active; command 'deactivate' accepted; mode: inactive; "
        "command 'activate' accepted; mode: active; damping: STALE_INPUT: joint_states is …; "
        "fault: STALE_INPUT: joint_states is …; command 'reset' accepted; mode: inactive"
    )


def test_many_different_sentences_at_once_are_logged_in_bounded_number(bench, caplog):
    controller = bench()
    report = controller.cycle()
    words = ["".join(pair) for pair in itertools.product("abcdefghij", repeat=2)]
    for _ in range(10):
        controller.loop._log_changes(dataclasses.replace(report, refused=tuple(words)), controller.clock.time)
    assert len(caplog.messages) == len(controller.loop._logged) == 20
    controller.loop._log_changes(dataclasses.replace(report, refused=tuple(words)), controller.clock.time + 1.0)
    assert (len(caplog.messages), len(controller.loop._logged)) == (40, 20)


def test_the_largest_time_that_a_message_holds_is_answered(bench):
    robot = bench()
    robot.clock.time = 2147483640.0
    robot.activate()
    assert robot.cycle(10).mode is Mode.ACTIVE


def test_a_stop_is_never_merged_away_and_passes_a_flood_of_other_requests(bench):
    robot = bench().activated(100)
    robot.command("estop")
    robot.command("reset")
    sent = len(robot.efforts())
    report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not robot.efforts()[sent:].any()
    assert len(robot.efforts()) == sent + 1
    assert robot.received("state")[-1].data.startswith("fault ESTOP")
    assert any("command 'reset' is refused in the cycle of an emergency stop" in each for each in report.refused)
    robot.request("reset")
    assert robot.activate().mode is Mode.ACTIVE
    for _ in range(1000):
        robot.command("activate")
    report = robot.request("estop")
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not report.command.tau.any()


def test_a_long_word_is_refused_without_being_repeated(bench):
    (sentence,) = bench().request("x" * 1000).refused
    assert sentence.endswith("command has 1000 characters (limit 40)")


def test_the_activation_at_the_start_can_be_cancelled(bench):
    robot = bench()
    robot.loop._activate_when_fresh = True
    robot.command("damp")
    robot.cycle(joints=False, base=False)
    assert robot.cycle(5).mode is Mode.INACTIVE
