"""Ages by timestamp: offset estimation, and refused stamps (constant, decreasing, far ahead)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.middleware.stamps import StampTracker

START = 1_700_000_000.0  # s: the other clock is a wall clock, ours starts with the computer


def accept(tracker, stamp, arrival):
    """Accept a timestamp, ns, with its local arrival, s, or return the reason of its refusal."""
    reason = tracker.refusal(stamp, arrival)
    if reason is None:
        tracker.accept(stamp, arrival)
    return reason


def feed(tracker, times, lag=0.0, start=START):
    """Send messages of a clock that is `start` ahead of ours; return the reasons of refusals."""
    lags = np.broadcast_to(lag, np.shape(times))
    return [
        accept(tracker, round((start + time) * 1e9), time + late)
        for time, late in zip(times, lags.tolist(), strict=True)
    ]


def fed(tracker, count=100, lag=0.0):
    """Return the tracker after messages every 2 ms."""
    feed(tracker, np.arange(count) * 0.002, lag)
    return tracker


def test_between_two_clocks_the_age_is_the_time_since_the_stamp():
    tracker = StampTracker()
    assert feed(tracker, np.arange(100) * 0.002, 0.0003) == [None] * 100
    assert tracker.age(0.198 + 0.0003) == pytest.approx(0.0, abs=1e-6)
    assert tracker.age(0.198 + 0.0403) == pytest.approx(0.04, abs=1e-6)
    tracker = fed(StampTracker(), 500, 0.0003)
    arrival = 4.0
    for time in np.arange(500, 2000) * 0.002:
        assert accept(tracker, round((START + time) * 1e9), arrival) is None
        assert tracker.age(arrival) == pytest.approx(arrival - time, abs=0.03)
    tracker = fed(StampTracker())
    assert None not in feed(tracker, 0.2 + np.arange(10) * 0.002, start=START + 5.0)
    assert tracker.age(0.218) == pytest.approx(0.02, abs=1e-3)
    assert feed(tracker, [0.220, 0.222]) == [None, None]
    assert tracker.age(0.222) == pytest.approx(0.0, abs=1e-6)
    assert None not in feed(tracker, [0.224, 0.226], start=START + 5.0)
    assert tracker.age(0.226) == pytest.approx(0.004, abs=1e-4)


@pytest.mark.parametrize("first", [0.9, 1.2, 2.9])
def test_queueing_time_with_dropped_messages(first):
    """The process was stopped for 3 s, and its sockets kept the first or the last messages."""
    tracker = fed(StampTracker(), 500, 0.0003)
    assert feed(tracker, [1.0 + first], 3.0 - first) == [None]
    assert tracker.age(4.0) == pytest.approx(3.0 - first, abs=0.03)


@given(st.lists(st.floats(0.0, 0.02), min_size=300, max_size=300))
def test_jitter_underestimates_the_age_at_most_by_the_smallest_latency(jitter):
    tracker = StampTracker()
    times = np.arange(len(jitter)) * 0.05  # no reordering
    feed(tracker, times, np.array(jitter))
    assert -1e-6 <= tracker.age(times[-1] + jitter[-1]) <= jitter[-1] + 1e-6


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.9999, 1.0001, 5.0])
def test_a_clock_of_another_rate_is_not_latency(rate):
    """Drifting clocks, and simulators that are slower or faster than real time."""
    tracker = StampTracker()
    for i in range(5000):
        assert accept(tracker, round((START + i * 0.002 * rate) * 1e9), i * 0.002) is None
    assert tracker.age(4999 * 0.002) < 0.003


@pytest.mark.parametrize("made", [StampTracker, lambda: StampTracker(lambda: START, 0.01)], ids=["own", "synchronized"])
@pytest.mark.parametrize(
    ("step", "said"),
    [
        (0.0, "header.stamp does not advance from"),
        (-0.004, "header.stamp is 0.004 s before the last message"),
        (60.0, "header.stamp is 59.998 s ahead of the "),
        (0.1, "header.stamp is 0.098 s ahead of the "),
    ],
)
def test_one_contradictory_stamp_is_refused(made, step, said):
    tracker = fed(made())
    last = 99 * 0.002
    assert accept(tracker, round((START + last + step) * 1e9), last + 0.002).startswith(said)
    assert tracker.age(last + 0.002) == pytest.approx(0.002, abs=1e-6)
    assert feed(tracker, [last + 0.004]) == [None]


def test_an_interleaved_stream_ahead_is_refused():
    """A second publisher with another clock."""
    tracker = fed(StampTracker())
    for time in 0.2 + np.arange(300) * 0.002:
        assert feed(tracker, [time]) == [None]
        assert "0.100 s ahead" in feed(tracker, [time + 0.1], -0.1)[0]
        assert tracker.age(time) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("period", "refused"), [(0.002, 5), (0.006, 2), (0.02, 1)])
def test_a_latency_that_falls_at_once_is_accepted(period, refused):
    tracker = StampTracker()
    feed(tracker, np.arange(100) * period, 0.1)
    reasons = feed(tracker, 100 * period + np.arange(20) * period)
    assert "0.100 s ahead of the previous messages" in reasons[0]
    assert [reason is None for reason in reasons] == [False] * refused + [True] * (20 - refused)


def test_late_messages_new_times_and_missing_stamps():
    tracker = fed(StampTracker(), 500)
    assert feed(tracker, [1.0, 1.5], [0.499, 0.0]) == [None, None]
    assert tracker.age(1.5) <= 0.025 + 1e-6
    tracker = fed(StampTracker())
    reasons = feed(tracker, 0.2 + np.arange(400) * 0.002, start=START - 10.0)
    assert all(reasons[:149])
    assert reasons[151:] == [None] * 249
    assert tracker.age(0.2 + 399 * 0.002) == pytest.approx(0.0, abs=1e-6)
    tracker = StampTracker()
    assert "header.stamp is 0" in accept(tracker, 0, 1.0)
    assert tracker.age(5.0) == np.inf


def known(clock_offset=START):
    return StampTracker(lambda: clock_offset, 0.01)


@pytest.mark.parametrize("latency", [0.0003, 0.04, 1.0])
def test_on_synchronized_clocks_a_constant_latency_counts(latency):
    tracker = known()
    assert feed(tracker, np.arange(100) * 0.002, latency) == [None] * 100
    assert tracker.age(0.198 + latency) == pytest.approx(latency, abs=1e-6)
    assert tracker.age(0.198 + latency + 0.02) == pytest.approx(latency + 0.02, abs=1e-6)
    assert tracker.transit_time(0.198 + latency + 0.02) == pytest.approx(latency, abs=1e-6)
    other = fed(StampTracker(), lag=latency)  # on other clocks it is an offset
    assert other.age(0.198 + latency) == pytest.approx(0.0, abs=1e-6)
    assert other.transit_time(0.198 + latency) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("clock_offset", "good"), [(0.0099, True), (0.0101, False), (np.nan, False)])
def test_on_synchronized_clocks_a_stamp_ahead_of_ours_is_refused(clock_offset, good):
    reason = accept(known(START - clock_offset), round(START * 1e9), 0.0)
    assert (reason is None) is good
    if np.isfinite(clock_offset) and not good:
        assert reason == "header.stamp is 0.010 s ahead of the local clock (limit 10 ms, safety.clock_tolerance)"


def test_ages_on_known_clocks():
    tracker = fed(known(), lag=1.0)
    assert feed(tracker, [1.2]) == [None]
    assert tracker.age(1.2) == pytest.approx(0.0, abs=1e-6)
    tracker = fed(known())
    for i in range(1, 201):  # our clock runs at half the rate of theirs
        time, stamp = 0.198 + 0.001 * i, round((START + 0.198 + 0.002 * i) * 1e9)
        if accept(tracker, stamp, time) is None:
            accepted = stamp
        assert tracker.age(time) >= 1e-9 * (stamp - accepted) - 0.002 - 1e-6
    assert tracker.age(time) > 0.3
    clock_offset = [START]
    tracker = StampTracker(lambda: clock_offset[0], 0.01)
    feed(tracker, np.arange(100) * 0.002, 0.001)
    clock_offset[0] += 5.0
    assert tracker.age(0.199) == pytest.approx(5.001, abs=1e-6)


@pytest.mark.parametrize("tracker", [StampTracker(), known()])
def test_a_clock_stall_is_measured(tracker):
    feed(tracker, np.arange(100) * 0.002)
    assert tracker.clock_stall == 0.0
    for i in range(1, 51):
        accept(tracker, round((START + 0.198 + 0.002 * i) * 1e9), 0.198)
        assert tracker.clock_stall == pytest.approx(0.002 * i, abs=1e-6)
    accept(tracker, round((START + 60.0) * 1e9), 0.198)  # an implausible stamp is ignored
    accept(tracker, round((START + 0.3) * 1e9), 0.198)
    assert tracker.clock_stall == pytest.approx(0.1, abs=1e-6)
    accept(tracker, round((START + 0.302) * 1e9), 0.302)
    assert tracker.clock_stall == 0.0
