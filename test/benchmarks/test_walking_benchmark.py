"""Benchmark of walking."""

import walking

from wbc_controller.validation.accuracy import estimation_trial


def test_cycles_of_a_walk_are_timed_by_kind(monkeypatch):
    monkeypatch.setattr(estimation_trial, "_REST_TIME", 0.1)
    for name, seconds in (("_STANDING", 0.3), ("_WALKING", 1.5), ("_STOPPING", 0.5)):
        monkeypatch.setattr(walking, name, seconds)
    times = walking.measure("go2", 1)
    assert len(times[walking.STAND]) > 100
    assert len(times[walking.FIRST]) == 4  # sets of supporting feet
    assert len(times[walking.SWITCH]) >= 2
    assert all(value > 0.0 for values in times.values() for value in values)
