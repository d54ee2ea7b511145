"""Hostile or faulty inputs neither end, stall nor deceive the loop."""

import threading
import time

import numpy as np

from wbc_controller.middleware.codec import encode
from wbc_controller.records import Mode


def said(report, words):
    return [sentence for sentence in report.refused if words in sentence]


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
    assert said(report, "command 'reset' is refused in the cycle of an emergency stop")
    robot.command("reset")
    robot.cycle()
    assert robot.activate().mode is Mode.ACTIVE
    for _ in range(1000):
        robot.command("activate")
    robot.command("estop")
    report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not report.command.tau.any()


def test_a_long_word_is_refused_without_being_repeated(bench, make):
    robot = bench()
    robot.send("command", make.string("x" * 1000))
    assert said(robot.cycle(), "command has 1000 characters (limit 40)")


def test_the_activation_at_the_start_can_be_cancelled(bench):
    robot = bench()
    robot.loop._activate_when_fresh = True
    robot.command("damp")
    robot.cycle(joints=False, base=False)
    assert robot.cycle(5).mode is Mode.INACTIVE


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
        while sent < 3 and time.monotonic() < deadline:
            robot.give_state()
            if len(times) > 100 * (sent + 1):
                robot.send_bytes("trajectory", payload, "com")
                sent += 1
            time.sleep(0.001)
    finally:
        stop.set()
        loop.wake()
        thread.join(10)
    assert sent == 3
    assert not thread.is_alive()
    began = time.perf_counter()
    robot.send_bytes("trajectory", payload, "com")
    loop.cycle()  # without a reader thread it is decoded here
    inline = time.perf_counter() - began
    assert np.quantile(np.diff(times), 0.99) < inline
