"""Benchmark of walking."""

import walking


def test_cycles_of_a_walk_are_timed_by_kind(monkeypatch):
    monkeypatch.setattr(walking, "_WALKING", 1.9)
    times = walking.measure("g1", 1)
    assert len(times[walking.STAND]) > 500
    assert len(times[walking.FIRST]) == 2  # single supports on either foot
    assert len(times[walking.SWITCH]) >= 4
    assert all(value > 0.0 for values in times.values() for value in values)
