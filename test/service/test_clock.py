"""A simulator's clock, and a loop that goes by it."""

from __future__ import annotations

import re
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


def test_a_wall_clock_that_is_set_is_said_where_stamps_are_compared_with_it(monkeypatch):
    now = {"wall": 1_700_000_000_000_000_000, "own": 50.0, "apart": 0.0}

    def own():
        now["own"] += 0.5 * now["apart"]
        return now["own"]

    monkeypatch.setattr(time, "time_ns", lambda: now["wall"])
    monkeypatch.setattr(time, "monotonic", own)
    clock, other = MonotonicClock(synchronized=True), MonotonicClock()
    assert clock.ahead() == pytest.approx(1.7e9 - 50.0, abs=1e-6)
    now["wall"] += 2_000_000_000
    now["own"] += 2.0
    assert clock.trouble() is None
    now["wall"] += 1_000_000  # within what synchronization does
    assert clock.trouble() is None
    now["wall"] += 5_000_000
    assert other.trouble() is None
    assert clock.trouble() == "this computer's clock was set forward by 0.005 s"
    assert clock.trouble() is None
    assert clock.ahead() == pytest.approx(1.7e9 - 50.0 + 0.006, abs=1e-5)
    now["wall"] -= 5_000_000
    now["apart"] = 0.01  # the processor was lost between the two readings: they say nothing
    assert clock.trouble() is None
    now["apart"] = 0.0
    assert clock.trouble().startswith("this computer's clock was set back by 0.0")


SYNCHRONIZED = {"safety": {"synchronized_clocks": True}}


def states(controller, latency, count=100):
    """States that arrive with a latency, constant from the start; negative where the robot's clock is ahead."""
    for _ in range(count):
        controller.clock.time += controller.period
        at = round((controller.clock.time - latency) * 1e9)
        controller.base(time=at)
        controller.joints(time=at)
        report = controller.loop.cycle()
    return report


def test_with_synchronized_clocks_a_constant_latency_does_not_activate(bench):
    controller = bench(changes=SYNCHRONIZED)
    assert states(controller, 1.0).ages == pytest.approx({"joint_states": 1.0, "odom": 1.0})
    controller.command("activate")
    (sentence,) = states(controller, 1.0, 1).refused
    assert sentence == (
        "command 'activate' is refused: joint_states is 1000 ms old (limit 50 ms); 1.000 s of it on its way, or the "
        "clocks are not synchronized; odom is 1000 ms old (limit 50 ms); 1.000 s of it on its way, or the clocks are "
        "not synchronized"
    )


def test_without_them_it_does(bench):
    controller = bench()
    states(controller, 1.0)
    controller.command("activate")
    assert states(controller, 1.0).mode is Mode.ACTIVE


@pytest.mark.parametrize(
    ("skew", "said"),
    [
        (0.2, "last refusal: header.stamp is 0.1"),
        (-0.2, "header.stamp is 0.200 s ahead of this computer's clock (limit 10 ms, safety.clock_tolerance)"),
    ],
)
def test_clocks_that_part_are_a_fault_that_says_by_how_much(bench, skew, said):
    controller = bench(changes=SYNCHRONIZED)
    states(controller, 0.0)
    controller.command("activate")
    assert states(controller, 0.0, 300).mode is Mode.ACTIVE
    report = states(controller, skew, 40)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")
    assert said in report.fault.sentence


def test_a_clock_that_is_set_while_active_is_a_fault_and_the_ages_begin_anew(bench, monkeypatch):
    controller = bench(changes=SYNCHRONIZED)
    states(controller, 0.0)
    controller.command("activate")
    assert states(controller, 0.0, 300).mode is Mode.ACTIVE
    clock = controller.clock
    with monkeypatch.context() as patch:
        patch.setattr(clock, "trouble", lambda: "this computer's clock was set forward by 3.500 s")
        patch.setattr(clock, "ahead", lambda: 3.5)
        report = states(controller, -3.5, 1)
        assert report.mode is Mode.DAMPING
        assert (report.fault.code, report.fault.sentence) == ("CLOCK", clock.trouble())
        patch.setattr(clock, "trouble", lambda: None)
        controller.command("reset")
        states(controller, -3.5, 10)
        controller.command("activate")
        assert states(controller, -3.5, 10).mode is Mode.ACTIVE


@pytest.mark.parametrize(("latency", "mode"), [(1.0, Mode.INACTIVE), (0.0, Mode.ACTIVE)])
def test_with_a_simulators_clock_a_constant_latency_counts_too(bench, latency, mode):
    controller = bench(changes=SYNCHRONIZED)
    clock = clock_of(controller.topics, controller.transport)
    controller.loop = controller.remake(clock)
    controller.command("activate")
    for _ in range(50):
        controller.send("clock", message("rosgraph_msgs/msg/Clock", clock=stamp(controller.time)))
        assert states(controller, latency, 1).mode is mode


@pytest.mark.parametrize("changes", [None, SYNCHRONIZED])
def test_a_simulators_clock_that_stands_still_while_states_go_on_is_a_fault_and_damping_goes_on(bench, changes):
    controller = bench(changes=changes)
    clock = clock_of(controller.topics, controller.transport)
    controller.loop = controller.remake(clock)
    controller.command("activate")
    for _ in range(700):
        controller.send("clock", message("rosgraph_msgs/msg/Clock", clock=stamp(controller.time)))
        report = states(controller, 0.0, 1)
    assert report.mode is Mode.ACTIVE
    timeout = controller.settings.safety.state_timeout
    froze = controller.clock.time
    for _ in range(round(timeout / controller.period) + 2):
        report = states(controller, 0.0, 1)
        if report.mode is not Mode.ACTIVE:
            break
    assert controller.clock.time - froze > timeout - 1e-9
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "CLOCK")
    assert re.fullmatch(
        r"the clock has stood still for 5[0-2] ms of the states' time \(limit 50 ms\)", report.fault.sentence
    )
    controller.v[controller.model.v_index] = 0.5
    report = states(controller, 0.0, 20)
    # The time of the torque rate does not stand still; those states are refused that are ahead of a known clock.
    assert (report.command.tau < 0.0).all() if changes is None else not report.command.tau.any()
