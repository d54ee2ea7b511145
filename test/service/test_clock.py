"""A simulator's clock, and a loop that goes by it."""

from __future__ import annotations

import threading
import time

import pytest

from wbc_controller.records import Mode
from wbc_controller.service.clock import ManualClock, MonotonicClock, SimulatedClock
from wbc_controller.service.controller_service import clock_of
from wbc_controller.wire.messages import message, stamp


def test_a_simulated_clock_shows_the_messages_and_never_goes_back():
    clock = SimulatedClock()
    assert (clock.now(), clock.stamp()) == (0.0, 0)
    assert "no time has come on the topic of the clock" in clock.trouble()
    clock.set(5_000_000_000)
    assert (clock.now(), clock.stamp(), clock.trouble()) == (5.0, 5_000_000_000, None)
    clock.set(1_000_000_000)
    assert (clock.now(), clock.stamp()) == (5.0, 1_000_000_000)
    assert clock.trouble() == "the simulated time went back from 5.000 to 1.000 s"
    assert clock.trouble() is None
    clock.set(1_500_000_000)
    assert clock.now() == pytest.approx(5.5)


def test_waiting_takes_simulated_time():
    clock, stop = SimulatedClock(), threading.Event()
    clock.set(0)
    waiting = threading.Thread(target=clock.wait, args=(stop, 0.01))
    waiting.start()
    time.sleep(0.1)  # ten times as long
    clock.set(9_000_000)
    assert waiting.is_alive()
    clock.set(10_000_000)
    waiting.join(5.0)
    assert not waiting.is_alive()
    waiting = threading.Thread(target=clock.wait, args=(stop, 0.01))
    waiting.start()
    stop.set()
    waiting.join(5.0)
    assert not waiting.is_alive()


@pytest.mark.parametrize("clock", [MonotonicClock(), ManualClock(1.0)])
def test_the_others_have_no_trouble_and_end_their_waiting(clock):
    stop = threading.Event()
    clock.wait(stop, 0.001)
    stop.set()
    clock.wait(stop, 60.0)
    assert clock.trouble() is None
    assert clock.stamp() > 0


@pytest.fixture
def simulated(bench):
    """A controller on a bench, and a function that gives it a time, a state of it, and a cycle."""
    controller = bench()
    clock = clock_of(controller.topics, controller.transport)
    controller.loop = controller.remake(clock)

    def cycle(seconds, **parts):
        controller.clock.time = seconds
        controller.send("clock", message("rosgraph_msgs/msg/Clock", clock=stamp(round(seconds * 1e9))))
        if parts.get("state", True):
            controller.base()
            controller.joints()
        return controller.loop.cycle()

    return controller, cycle


def test_without_a_clock_there_is_no_activation(simulated):
    controller, cycle = simulated
    controller.command("activate")
    controller.clock.time = 0.9
    controller.base()
    controller.joints()
    (sentence,) = controller.loop.cycle().refused
    assert "use_sim_time is set, and no time has come" in sentence
    controller.command("activate")
    assert cycle(1.0).mode is Mode.ACTIVE


def test_ages_ramps_and_stamps_go_by_simulated_time(simulated):
    controller, cycle = simulated
    controller.command("activate")
    cycle(1.0)
    time.sleep(0.1)  # twice what a state may be old
    assert cycle(1.002, state=False).mode is Mode.ACTIVE
    report = cycle(1.02, state=False)
    assert report.ages["joint_states"] == pytest.approx(0.02)
    share = controller.settings.safety.activation_ramp
    assert controller.loop.controller.supervisor._share.sample(1.0 + 0.5 * share) == pytest.approx(0.5)
    assert controller.received("diagnostics")[-1].header.stamp.sec == 1
    report = cycle(1.06, state=False)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")


def test_a_simulator_that_begins_anew_is_a_fault_with_that_reason(simulated):
    controller, cycle = simulated
    controller.command("activate")
    assert cycle(10.0).mode is Mode.ACTIVE
    report = cycle(0.5)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "CLOCK")
    assert report.fault.sentence == "the simulated time went back from 10.000 to 0.500 s"
    controller.command("reset")
    cycle(0.502)
    controller.command("activate")
    assert cycle(0.504).mode is Mode.ACTIVE
