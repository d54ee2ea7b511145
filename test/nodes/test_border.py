"""Hostile or faulty inputs neither end, stall nor deceive the loop."""

import threading
import time

import numpy as np
import pytest

from wbc_controller.middleware.codec import encode, message
from wbc_controller.records import Mode


def said(report, words):
    return [sentence for sentence in report.refused if words in sentence]


def running(bench, **changes):
    robot = bench(changes=changes or None).activated(600)
    return robot


@pytest.mark.parametrize("number", ["0x" + "f" * 3700, "9" * 4000])
@pytest.mark.parametrize("key", ["safety: {activation_ramp", "tasks: {com: {stiffness", "tasks: {com: {weight"])
def test_a_number_that_no_double_holds_is_refused(bench, make, key, number):
    robot = running(bench)
    robot.send("update", make.string(f"{{{key}: {number}{'}' * (key.count('{') + 1)}"))
    report = robot.cycle()
    assert report.mode is Mode.ACTIVE
    assert len(report.refused) == 1


def test_duplicate_keys_and_aliases_are_refused(bench, make):
    robot = running(bench)
    robot.send("update", make.string("{tasks: {com: {weight: 1, weight: 2}}}"))
    robot.send("update", make.string("{tasks: {com: &a {weight: 1}, base: *a}}"))
    refused = robot.cycle().refused
    assert "duplicate key 'weight'" in refused[0]
    assert "aliases (*name) are not supported" in refused[1]


@pytest.mark.parametrize(("sec", "nanosec"), [(2147483647, 1_000_000_000), (-1, 0), (0, 4_000_000_000)])
def test_a_stamp_that_is_no_time_is_refused(bench, make, sec, nanosec):
    robot = running(bench)
    content = make.joint_state(robot.model.joints, robot.q[robot.model.q_index], robot.v[robot.model.v_index])
    content.header.stamp = message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    robot.clock.time += robot.period
    robot.send("joint_states", content)
    report = robot.loop.cycle()
    assert report.mode is Mode.ACTIVE
    assert said(report, f"header.stamp has sec = {sec}, nanosec = {nanosec}")


def test_the_largest_time_that_a_message_holds_is_answered(bench):
    robot = bench()
    robot.clock.time = 2147483640.0
    robot.activate()
    assert robot.cycle(10).mode is Mode.ACTIVE


def test_a_stop_is_never_merged_away(bench):
    robot = running(bench)
    robot.command("estop")
    robot.command("reset")
    sent = len(robot.efforts())
    report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not robot.efforts()[sent:].any()
    assert len(robot.efforts()) == sent + 1
    assert robot.received("state")[-1].data.startswith("fault ESTOP")
    assert said(report, "command 'reset' is refused in the cycle of an emergency stop")


def test_a_stop_passes_a_flood_of_other_requests(bench):
    robot = running(bench)
    for _ in range(1000):
        robot.command("activate")
    robot.command("estop")
    report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not report.command.tau.any()


def test_dropped_requests_are_counted_and_reported(bench):
    robot = running(bench)
    for _ in range(150):
        robot.command("activate")
    sentence = "/wbc_controller/command: 50 messages dropped: more than 100 requests at once"
    assert said(robot.cycle(), sentence)
    (status,) = robot.received("diagnostics")[-1].status
    assert sentence in [value.value for value in status.values if value.key.startswith("refused/")]
    assert f"refused {sentence}" in status.message
    assert status.level == 1


def test_oversized_messages_are_dropped_unread(bench, make, caplog):
    robot = running(bench)
    robot.send("command", make.string("x" * 10_000_000))
    began = time.perf_counter()
    report = robot.cycle()
    assert said(report, "1 messages dropped: more than 262144 bytes")
    (status,) = robot.received("diagnostics")[-1].status
    assert "refused /wbc_controller/command: 1 messages dropped: more than 262144 bytes" in status.message
    assert time.perf_counter() - began < 1.0
    assert max(map(len, caplog.messages), default=0) < 1000


def test_a_long_word_is_refused_without_being_repeated(bench, make):
    robot = running(bench)
    robot.send("command", make.string("x" * 1000))
    assert said(robot.cycle(), "command has 1000 characters (limit 40)")


def test_a_state_that_waited_in_a_queue_is_stale(bench):
    """As after SIGSTOP: the oldest messages arrive first."""
    robot = running(bench)
    behind = robot.time
    robot.clock.time += 3.0
    robot.base(time=behind + 2_000_000)
    robot.joints(time=behind + 2_000_000)
    report = robot.loop.cycle()
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")
    assert report.inputs.ages["joint_states"] == pytest.approx(3.0, abs=0.01)


def test_a_state_that_grows_old_while_the_cycle_runs_is_not_answered(bench, monkeypatch):
    """The process was stopped between reading and publishing."""
    robot = running(bench)
    solve = robot.loop.controller.qp.solve

    def stopped(*arguments):
        robot.clock.time += 1.0
        return solve(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(robot.loop.controller.qp, "solve", stopped)
        report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")
    assert report.solution is None


def test_older_states_that_come_later_are_not_used(bench):
    robot = running(bench)
    stamp = robot.cycle().stamp
    robot.clock.time += robot.period
    robot.joints(time=stamp - 4_000_000)
    robot.base()
    report = robot.loop.cycle()
    assert report.stamp == stamp
    assert said(report, "header.stamp is 0.004 s before the last message")


@pytest.mark.parametrize("stamp", [0, 101_000_000_000])
def test_constant_stamps_are_reported_and_lead_to_damping(bench, stamp):
    robot = running(bench)
    for _ in range(40):
        robot.clock.time += robot.period
        robot.base()
        robot.joints(time=stamp or 0)
        report = robot.loop.cycle()
    assert report.mode is Mode.DAMPING
    assert report.fault.code == "STALE_INPUT"
    assert "header.stamp" in report.fault.sentence


def test_one_stamp_far_ahead_is_refused_without_effect(bench):
    robot = running(bench)
    robot.clock.time += robot.period
    robot.base()
    robot.joints(time=robot.time + 60_000_000_000)
    assert said(robot.loop.cycle(), "ahead of the previous messages")
    assert robot.cycle(50).mode is Mode.ACTIVE


def test_stamps_that_go_back_move_no_reference(bench, make):
    robot = running(bench)
    start = robot.loop.controller.dynamics.com.copy()
    robot.send("setpoint", make.point(start + [0.02, 0.0, 0.0]), "com")
    robot.cycle(600)
    wanted = robot.loop.controller.board.sample(robot.clock.time).tasks["com"].position
    robot.clock.time += robot.period
    robot.base(time=robot.time - 10_000_000_000)
    robot.joints(time=robot.time - 10_000_000_000)
    report = robot.loop.cycle()
    assert report.mode is Mode.ACTIVE
    np.testing.assert_array_equal(robot.loop.controller.board.sample(report.stamp * 1e-9).tasks["com"].position, wanted)


def test_settings_and_references_of_one_update_are_taken_together_or_not_at_all(bench, make):
    robot = running(bench)
    robot.cycle(40, joints=False)
    assert robot.loop.controller.mode is Mode.DAMPING
    robot.send("update", make.string("{control: {weight_ramp: 0.9}, tasks: {com: {setpoint: [0, 0, 0.3]}}}"))
    report = robot.cycle()
    assert report.refused
    assert robot.loop.controller.live.settings.control.weight_ramp == 0.5


def test_the_activation_at_the_start_can_be_cancelled(bench):
    robot = bench()
    robot.loop._activate_when_fresh = True
    robot.command("damp")
    robot.cycle(joints=False, base=False)
    assert robot.cycle(5).mode is Mode.INACTIVE


def test_refusals_are_logged_in_bounded_number_and_memory(bench, make, caplog):
    robot = running(bench)
    rng = np.random.default_rng(0)
    for i in range(1500):
        robot.clock.time += robot.period
        pose = [0.0, 0.0, 0.3, *rng.normal(size=4)]
        robot.base(pose=pose)
        robot.send("update", make.string(f"{{tasks: {{name{i}: {{weight: 1}}}}}}"))
        robot.joints()
        robot.loop.cycle()
    assert len(caplog.messages) < 3 * 20 + 10
    assert len(robot.loop._logged) <= 20


def test_a_first_point_that_is_almost_due_is_not_jumped_to(bench, make):
    robot = running(bench)
    start = robot.loop.controller.dynamics.com.copy()
    points = [(0.0, [[*(start + [0.01, 0.0, 0.0]), 0, 0, 0, 1]]), (1.0, [[*(start + [0.02, 0.0, 0.0]), 0, 0, 0, 1]])]
    robot.send("trajectory", make.frame_trajectory(points, start=robot.time + 2_500_000), "com")
    accelerations = []
    for _ in range(600):
        robot.cycle()
        accelerations.append(robot.loop.controller.board.sample(robot.clock.time).tasks["com"].acceleration)
    assert np.abs(accelerations).max() < 1.0  # m/s²; thousands after a jump
    np.testing.assert_allclose(
        robot.loop.controller.board.sample(robot.clock.time).tasks["com"].position, start + [0.02, 0.0, 0.0], atol=1e-9
    )


def test_a_long_trajectory_delays_no_cycle(bench, make):
    """Cycles continue while a thousand points are decoded; the longest pause is far below the decoding time."""
    robot = bench()
    loop, stop = robot.loop, threading.Event()
    times: list[float] = []
    loop.observers = (lambda report: times.append(time.perf_counter()),)
    points = [(0.01 * (i + 1), [[0.0, 0.0, 0.3, 0, 0, 0, 1]]) for i in range(4000)]
    payload = encode(make.frame_trajectory(points))
    loop.period, loop.triggered = 1e-3, True
    thread = threading.Thread(target=loop.run, args=(stop,))
    thread.start()
    try:
        deadline = time.monotonic() + 20.0
        sent = 0
        while sent < 5 and time.monotonic() < deadline:
            robot.give_state()
            if len(times) > 100 * (sent + 1):
                robot.send_bytes("trajectory", payload, "com")
                sent += 1
            time.sleep(0.001)
    finally:
        stop.set()
        loop.wake()
        thread.join(10)
    assert sent == 5
    assert not thread.is_alive()
    began = time.perf_counter()
    robot.send_bytes("trajectory", payload, "com")
    loop.cycle()  # without a reader thread it is decoded here
    inline = time.perf_counter() - began
    assert np.quantile(np.diff(times), 0.99) < inline
