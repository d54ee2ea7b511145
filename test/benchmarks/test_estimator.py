"""Benchmark of the base estimate."""

import estimator


def test_updates_of_a_standing_robot_are_timed():
    updates, cycles, points = estimator.measure("go2", 0.1)
    assert len(updates) == len(cycles) == 50
    assert all(0.0 < update < cycle for update, cycle in zip(updates, cycles, strict=True))
    assert points == 4
