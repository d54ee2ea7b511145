"""Ages by stamp: an offset that is learned, and stamps that stand still, go back, or are far ahead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.service.stamps import StampTracker

START = 1_700_000_000.0  # s: the other clock is a wall clock, ours counts from the start of the machine


def feed(tracker, times, lag=0.0, start=START):
    """Messages of a clock that is `start` ahead of ours; gives the reasons for refusals."""
    lags = np.broadcast_to(lag, np.shape(times))
    return [
        tracker.judge(round((start + time) * 1e9), time + late) for time, late in zip(times, lags.tolist(), strict=True)
    ]


def test_nothing_has_come():
    assert StampTracker().age(5.0) == np.inf


def test_between_two_clocks_the_age_is_the_time_since_the_stamp():
    tracker = StampTracker()
    assert feed(tracker, np.arange(100) * 0.002, 0.0003) == [None] * 100
    assert tracker.age(0.198 + 0.0003) == pytest.approx(0.0, abs=1e-6)
    assert tracker.age(0.198 + 0.0403) == pytest.approx(0.04, abs=1e-6)


def test_what_waited_in_a_queue_is_old_when_it_arrives():
    """The process stood still for 3 s; then what had come meanwhile arrives at once, the oldest first."""
    tracker = StampTracker()
    feed(tracker, np.arange(500) * 0.002, 0.0003)
    arrival = 4.0
    for time in np.arange(500, 2000) * 0.002:
        assert tracker.judge(round((START + time) * 1e9), arrival) is None
        assert tracker.age(arrival) == pytest.approx(arrival - time, abs=0.02 + (time - 1.0))
        if time < 2.0:
            assert tracker.age(arrival) > 1.0


@given(st.lists(st.floats(0.0, 0.02), min_size=300, max_size=300))
def test_jitter_never_makes_a_message_look_younger_than_it_is_by_more_than_the_least_latency(jitter):
    tracker = StampTracker()
    times = np.arange(len(jitter)) * 0.05  # no reordering
    feed(tracker, times, np.array(jitter))
    now = times[-1] + jitter[-1]
    assert -1e-6 <= tracker.age(now) <= jitter[-1] + 1e-6


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.9999, 1.0001, 5.0])
def test_a_clock_of_another_rate_is_not_latency(rate):
    """Drifting clocks, and simulators that are slower or faster than real time."""
    tracker = StampTracker()
    for i in range(5000):
        assert tracker.judge(round((START + i * 0.002 * rate) * 1e9), i * 0.002) is None
    assert tracker.age(4999 * 0.002) < 0.003


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (0.0, "header.stamp stands still at"),
        (-0.004, "header.stamp is 0.004 s before that of the last message"),
        (-10.0, "header.stamp is 10.000 s before"),
        (60.0, "header.stamp is 59.998 s ahead of the messages before"),
    ],
)
def test_a_stamp_that_contradicts_the_others_is_refused_and_the_others_go_on(step, said):
    tracker = StampTracker()
    feed(tracker, np.arange(100) * 0.002)
    last = 99 * 0.002
    assert tracker.judge(round((START + last + step) * 1e9), last + 0.002).startswith(said)
    assert tracker.age(last + 0.002) == pytest.approx(0.002, abs=1e-6)
    assert feed(tracker, [last + 0.004]) == [None]


def test_a_stream_with_a_new_time_is_taken_after_a_while():
    tracker = StampTracker()
    feed(tracker, np.arange(100) * 0.002)
    reasons = feed(tracker, 0.2 + np.arange(400) * 0.002, start=START - 10.0)
    assert all(reasons[:149])
    assert reasons[151:] == [None] * 249
    assert tracker.age(0.2 + 399 * 0.002) == pytest.approx(0.0, abs=1e-6)


def test_no_time_at_all():
    assert "header.stamp is 0" in StampTracker().judge(0, 1.0)
