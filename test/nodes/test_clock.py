"""Simulated time, and a loop with this clock."""

import re
import threading
import time

import numpy as np
import pytest
from starved import StarvedThread
from waiting import running

from wbc_controller.errors import TransportError
from wbc_controller.middleware.codec import encode, message, time_fields
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, counterpart, endpoints
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes import clock as clock_module
from wbc_controller.nodes.clock import MonotonicClock, SimulatedClock
from wbc_controller.nodes.controller_service import make_clock
from wbc_controller.records import Mode


def time_message(nanoseconds):
    return message("rosgraph_msgs/msg/Clock", clock=time_fields(nanoseconds))


@pytest.fixture
def clock_and_time():
    """A simulated clock, and a function that publishes a time, ns, or bytes."""
    bus = MemoryBus()
    topics = endpoints([topic for topic in CONTROLLER_TOPICS if topic.key == "clock"], "controller")
    publish = MemoryTransport(bus).advertise(counterpart(topics[0]))
    return SimulatedClock(topics, MemoryTransport(bus)), lambda content: publish(
        content if isinstance(content, bytes) else encode(time_message(content))
    )


def test_a_simulated_clock_shows_the_messages_and_never_goes_back(clock_and_time):
    clock, publish = clock_and_time
    clock.refresh()
    assert (clock.now(), clock.stamp()) == (0.0, 0)
    assert clock.clock_fault() == "use_sim_time is set, but no time was received on /clock"
    publish(5_000_000_000)
    assert clock.now() == 0.0  # until it is read
    clock.refresh()
    assert (clock.now(), clock.stamp(), clock.clock_fault()) == (5.0, 5_000_000_000, None)
    publish(1_000_000_000)
    clock.refresh()
    assert (clock.now(), clock.stamp(), clock.clock_offset()) == (5.0, 1_000_000_000, -4.0)
    assert clock.clock_fault() == "the simulated time went back from 5.000 to 1.000 s"
    assert clock.clock_fault() is None
    publish(1_500_000_000)
    clock.refresh()
    assert clock.now() == pytest.approx(5.5)


def test_a_jump_back_is_detected_after_later_times(clock_and_time):
    clock, publish = clock_and_time
    for time_ns in (5_000_000_000, 5_002_000_000, 1_000_000_000, 6_000_000_000):
        publish(time_ns)
    clock.refresh()
    assert clock.clock_fault() == "the simulated time went back from 5.002 to 1.000 s"
    assert clock.now() == pytest.approx(10.002)


def test_the_resolution_is_the_smallest_of_the_newest_steps(clock_and_time):
    clock, publish = clock_and_time
    for time_ms, step in ((100, np.inf), (200, 0.1), (200, 0.1), (300, 0.1)):
        publish(time_ms * 1_000_000)
        clock.refresh()
        assert clock.resolution() == pytest.approx(step)
    for time_ms in (900, 902):  # messages were dropped before the first
        publish(time_ms * 1_000_000)
    clock.refresh()
    assert clock.resolution() == pytest.approx(0.002)


def test_a_flood_of_times_costs_a_bounded_number_of_reads(clock_and_time, monkeypatch):
    clock, publish = clock_and_time
    reads = []
    read = clock_module.decode
    monkeypatch.setattr(clock_module, "decode", lambda payload, kind: reads.append(1) or read(payload, kind))
    for i in range(1, 10_001):
        publish(i * 20_000)
    clock.refresh()
    assert clock.stamp() == 200_000_000
    assert len(reads) <= 10


def test_messages_that_are_no_time_are_refused_and_logged_once_a_second(clock_and_time, monkeypatch, caplog):
    clock, publish = clock_and_time
    now, negative = [100.0], encode(message("rosgraph_msgs/msg/Clock", clock={"sec": -1}))
    monkeypatch.setattr(clock_module.time, "monotonic", lambda: now[0])
    publish(5_000_000_000)
    for _ in range(3):
        publish(b"\0\1\0\0")
        publish(negative)
        clock.refresh()
    assert clock.stamp() == 5_000_000_000
    assert len(caplog.records) == 1
    assert "/clock: refused: 4 bytes are not a rosgraph_msgs/msg/Clock" in caplog.text
    now[0] += 1.0
    publish(negative)
    clock.refresh()
    assert "clock has sec = -1" in caplog.records[1].message


def test_waiting_takes_simulated_time(clock_and_time):
    (clock, publish), stop = clock_and_time, threading.Event()
    publish(0)
    clock.refresh()
    with running(clock.wait, stop, 0.01, stop=lambda: publish(10_000_000)) as waiting:
        publish(9_000_000)
        time.sleep(0.1)  # ten times as long
        assert waiting.is_alive()
    with running(clock.wait, stop, 0.01, stop=stop.set):
        pass


def on_simulated_time(bench, changes=None):
    controller = bench(changes=changes)
    controller.loop = controller.remake(SimulatedClock(controller.topics, controller.transport))
    return controller


@pytest.fixture
def simulated(bench):
    """A controller on a bench, and a function that publishes a time and its state, and runs a cycle."""
    controller = on_simulated_time(bench)

    def cycle(seconds, **parts):
        controller.clock.time = seconds
        controller.send("clock", time_message(round(seconds * 1e9)))
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
    assert "use_sim_time is set, but no time was received on /clock" in sentence
    controller.command("activate")
    assert cycle(1.0).mode is Mode.ACTIVE


def test_ages_ramps_and_stamps_go_by_simulated_time(simulated):
    controller, cycle = simulated
    controller.command("activate")
    cycle(1.0)
    time.sleep(0.1)  # twice the largest age
    assert cycle(1.002, state=False).mode is Mode.ACTIVE
    report = cycle(1.02, state=False)
    assert report.inputs.ages["joint_states"] == pytest.approx(0.02)
    share = controller.settings.safety.activation_ramp
    assert controller.loop.controller.supervisor._share.sample(1.0 + 0.5 * share) == pytest.approx(0.5)
    assert controller.received("diagnostics")[-1].header.stamp.sec == 1
    report = cycle(1.06, state=False)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")


def test_a_restart_of_the_simulator_is_a_clock_fault(simulated):
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


def test_a_step_of_a_synchronized_wall_clock_is_reported(monkeypatch):
    now = {"wall": 1_700_000_000_000_000_000, "own": 50.0, "apart": 0.0}

    def own():
        now["own"] += 0.5 * now["apart"]
        return now["own"]

    monkeypatch.setattr(time, "time_ns", lambda: now["wall"])
    monkeypatch.setattr(time, "monotonic", own)
    clock, other = MonotonicClock(synchronized=True), MonotonicClock()
    assert clock.clock_offset() == pytest.approx(1.7e9 - 50.0, abs=1e-6)
    now["wall"] += 2_000_000_000
    now["own"] += 2.0
    assert clock.clock_fault() is None
    now["wall"] += 1_000_000  # within the accuracy of synchronization
    assert clock.clock_fault() is None
    now["wall"] += 5_000_000
    assert other.clock_fault() is None
    assert clock.clock_fault() == "this computer's clock was set forward by 0.005 s"
    assert clock.clock_fault() is None
    assert clock.clock_offset() == pytest.approx(1.7e9 - 50.0 + 0.006, abs=1e-5)
    now["wall"] -= 5_000_000
    now["apart"] = 0.01  # preempted between the two readings: no result
    assert clock.clock_fault() is None
    now["apart"] = 0.0
    assert clock.clock_fault().startswith("this computer's clock was set back by 0.0")


SYNCHRONIZED = {"safety": {"synchronized_clocks": True}}


def states(controller, latency, count=100):
    """Send states with a latency that is constant from the start; negative if the robot's clock is ahead."""
    for _ in range(count):
        controller.clock.time += controller.period
        at = round((controller.clock.time - latency) * 1e9)
        controller.base(time=at)
        controller.joints(time=at)
        report = controller.loop.cycle()
    return report


def test_only_with_synchronized_clocks_a_constant_latency_prevents_the_activation(bench):
    controller = bench(changes=SYNCHRONIZED)
    assert states(controller, 1.0).inputs.ages == pytest.approx({"joint_states": 1.0, "odom": 1.0})
    controller.command("activate")
    (sentence,) = states(controller, 1.0, 1).refused
    assert sentence == (
        "command 'activate' is refused: joint_states is 1000 ms old (limit 50 ms); 1.000 s of it in transit, or the "
        "clocks are not synchronized; odom is 1000 ms old (limit 50 ms); 1.000 s of it in transit, or the clocks are "
        "not synchronized"
    )
    controller = bench()  # without synchronized clocks the latency is an offset
    states(controller, 1.0)
    controller.command("activate")
    assert states(controller, 1.0).mode is Mode.ACTIVE


@pytest.mark.parametrize(
    ("skew", "said"),
    [
        (0.2, "last refusal: header.stamp is 0.1"),
        (-0.2, "header.stamp is 0.200 s ahead of the local clock (limit 10 ms, safety.clock_tolerance)"),
    ],
)
def test_clocks_that_part_are_a_fault_that_says_by_how_much(bench, skew, said):
    controller = bench(changes=SYNCHRONIZED)
    states(controller, 0.0)
    controller.command("activate")
    assert states(controller, 0.0, 20).mode is Mode.ACTIVE
    report = states(controller, skew, 40)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")
    assert said in report.fault.sentence


@pytest.mark.parametrize("changes", [None, SYNCHRONIZED])
def test_a_stall_of_simulated_time_is_a_fault_and_damping_continues(bench, changes):
    controller = on_simulated_time(bench, changes)
    controller.command("activate")
    for _ in range(120):
        controller.send("clock", time_message(controller.time))
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
    assert re.fullmatch(r"the clock stopped for 5[0-2] ms of the states' time \(limit 50 ms\)", report.fault.sentence)
    controller.v[controller.model.v_index] = 0.5
    report = states(controller, 0.0, 20)
    # The time of the torque rate continues; states ahead of a known clock are refused.
    assert (report.command.tau < 0.0).all() if changes is None else not report.command.tau.any()


@pytest.fixture
def starved(bench):
    """A controller with simulated time and a transport thread on request, active for 0.2 s."""
    controller = bench()
    controller.transport.close()
    controller.transport = StarvedThread(controller.bus)
    clock = make_clock(controller.settings, controller.topics, controller.transport, use_sim_time=True)
    controller.loop = controller.remake(clock)
    controller.command("activate")
    for _ in range(100):
        controller.send("clock", time_message(controller.time))
        controller.transport.run()
        report = states(controller, 0.0, 1)
    assert report.mode is Mode.ACTIVE
    return controller


@pytest.mark.parametrize("late", [1, 20])
def test_times_that_arrive_after_their_states_are_no_fault_within_the_limit_of_the_stamps(starved, late):
    """Two topics are two readers: the middleware may deliver a state before its time."""
    for count in range(200):
        starved.give_state()
        now = starved.clock.time
        if count % (2 * late) >= late:
            starved.send("clock", time_message(round((now - late * starved.period) * 1e9)))
        report = starved.loop.cycle()
        assert (report.mode, report.fault) == (Mode.ACTIVE, None), count
        assert max(report.inputs.ages.values()) <= 2.0 * late * starved.period + 1e-9


def test_the_simulator_may_pause(starved):
    for _ in range(200):
        report = starved.loop.cycle()
    assert (report.mode, report.fault) == (Mode.ACTIVE, None)
    assert states_with_time(starved, 60).mode is Mode.ACTIVE


def time_and_state(controller, *, with_time=True):
    """Send the time after a period, and give the state."""
    if with_time:
        controller.send("clock", time_message(round((controller.clock.time + controller.period) * 1e9)))
    controller.give_state()


def states_with_time(controller, count, every=1):
    """Send states with the time before each or before some: a clock coarser than the states."""
    for number in range(count):
        time_and_state(controller, with_time=number % every == 0)
        report = controller.loop.cycle()
        if report.fault is not None:
            break
    return report


@pytest.mark.parametrize(
    ("changes", "rate", "asked", "said"),
    [
        (None, 10, 1, "in steps of 100 ms, too coarse for ages up to 50 ms (safety.state_timeout)"),
        (None, 10, 100, "in steps of 100 ms, too coarse for ages up to 50 ms (safety.state_timeout)"),
        (None, 15, 100, "in steps of 66 ms, too coarse for ages up to 50 ms (safety.state_timeout)"),
        (SYNCHRONIZED, 10, 20, "in steps of 100 ms, too coarse for ages up to 10 ms (safety.clock_tolerance)"),
        (SYNCHRONIZED, 50, 125, "in steps of 20 ms, too coarse for ages up to 10 ms (safety.clock_tolerance)"),
    ],
)
def test_with_a_coarse_clock_activation_is_refused_with_its_step(bench, changes, rate, asked, said):
    """Activation in the first step of the clock, at one of its times, or between two."""
    controller = on_simulated_time(bench, changes)
    every, refused = round(1.0 / (rate * controller.period)), []
    for number in range(160):
        time_and_state(controller, with_time=number % every == 0)
        if number == asked:
            controller.command("activate")
        report = controller.loop.cycle()
        refused += [sentence for sentence in report.refused if "'activate'" in sentence]
        assert (report.mode, report.fault) == (Mode.INACTIVE, None)
    assert len(refused) == 1
    assert said in refused[0] or (asked < every and "the step of the clock is unknown" in refused[0])


def test_an_activation_at_the_start_waits_for_the_step_of_the_clock(bench):
    controller = on_simulated_time(bench)
    controller.loop._activate_when_fresh = True
    modes = []
    for number in range(20):
        time_and_state(controller, with_time=number in (0, 10, 11))
        modes.append(controller.loop.cycle().mode)
    assert modes == [Mode.INACTIVE] * 10 + [Mode.ACTIVE] * 10


@pytest.mark.parametrize(("changes", "rate"), [(None, 20), (SYNCHRONIZED, 100)])
def test_a_clock_as_fine_as_the_limit_is_accepted(bench, changes, rate):
    controller = on_simulated_time(bench, changes)
    every = round(1.0 / (rate * controller.period))
    states_with_time(controller, 3 * every, every=every)
    controller.command("activate")
    assert states_with_time(controller, 150, every=every).mode is Mode.ACTIVE


def test_torques_of_a_state_that_became_stale_are_not_sent(starved, monkeypatch):
    """The simulator continued while the process was stopped during a cycle."""
    computed = starved.loop.controller.cycle

    def slow(inputs):
        result = computed(inputs)
        if inputs.problem is None:
            starved.send("clock", time_message(starved.time + 60_000_000))
        return result

    before = 0.5 * starved.model.effort_limits
    starved.loop.controller.supervisor.torques_sent = before  # far from those of the solution and of damping
    monkeypatch.setattr(starved.loop.controller, "cycle", slow)
    report = states_with_time(starved, 1)
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "STALE_INPUT")
    tau, rate = starved.efforts()[-1], starved.settings.limits.torque_rate
    assert np.array_equal(tau, report.command.tau)
    assert np.abs(tau - before) == pytest.approx(rate * starved.period * starved.model.effort_limits)


def test_an_unreadable_clock_is_logged_and_the_loop_continues(bench, monkeypatch, caplog):
    controller = bench()
    clock = SimulatedClock(controller.topics, controller.transport)
    loop, stop, waits = controller.remake(clock), threading.Event(), []

    def broken(stop, seconds):
        waits.append(seconds)
        if len(waits) == 3:
            stop.set()
        raise TransportError("cannot read /clock: deliberate")

    monkeypatch.setattr(clock, "wait", broken)
    loop.triggered = False
    loop.run(stop)
    assert len(waits) == 3
    assert "cannot read /clock: deliberate" in caplog.text


@pytest.mark.parametrize("by_itself", [True, False])
def test_an_activation_with_late_first_torques_is_refused(simulated, monkeypatch, by_itself):
    """Before the first torques a simulator does not wait for the controller, and no torques were sent."""
    controller, cycle = simulated
    loop, computed = controller.loop, controller.loop.controller.cycle

    def slow(inputs):
        result = computed(inputs)
        if result.mode is Mode.ACTIVE:
            controller.send("clock", time_message(round(inputs.now * 1e9) + 60_000_000))
        return result

    cycle(1.0)
    if by_itself:
        loop._activate_when_fresh = True
    else:
        controller.command("activate")
    with monkeypatch.context() as patch:
        patch.setattr(loop.controller, "cycle", slow)
        report = cycle(1.002)
    assert (report.mode, report.fault) == (Mode.INACTIVE, None)
    (sentence,) = report.refused
    assert re.match(
        r"command 'activate' is refused: after the computation of the torques, joint_states is 60 ms old", sentence
    )
    assert not controller.efforts().any()
    report = cycle(1.064)
    assert report.mode is (Mode.ACTIVE if by_itself else Mode.INACTIVE)
    assert report.fault is None


@pytest.mark.parametrize("synchronized", [False, True])
def test_a_loop_that_loses_the_processor_after_it_has_taken_a_state_takes_the_newest(bench, synchronized):
    controller = bench(changes={"safety": {"synchronized_clocks": synchronized}})
    controller.cycle(10)
    controller.activate()
    assert controller.cycle(100).mode is Mode.ACTIVE
    controller.give_state()
    assert controller.loop._inputs.wait(0.0)
    for _ in range(30):  # 60 ms, more than the limit of the ages
        controller.give_state()
    report = controller.loop.cycle()
    assert (report.mode, report.fault) == (Mode.ACTIVE, None)
    assert max(report.inputs.ages.values()) == pytest.approx(0.0, abs=1e-9)
