"""Benchmark of the base estimate."""

import estimator

from wbc_controller.validation.accuracy import estimation_trial


def test_updates_of_a_standing_robot_are_timed(monkeypatch):
    monkeypatch.setattr(estimation_trial, "_REST_TIME", 0.1)
    updates, cycles, points = estimator.measure("go2", 0.1)
    assert len(updates) == len(cycles) == 50
    assert all(0.0 < update < cycle for update, cycle in zip(updates, cycles, strict=True))
    assert points == 4
