"""Benchmarks in this process for some cycles, and their statistics."""

import calls
import estimator
import new_robots
import numpy as np
import pytest
import sizes
import walking
from our_cycle import make_model, parse_settings
from timing import exponent, share, summary

from wbc_controller.controller.build.program import make_qp
from wbc_controller.validation.accuracy import estimation_trial


@pytest.fixture
def short_rest(monkeypatch):
    monkeypatch.setattr(estimation_trial, "_REST_TIME", 0.1)


def test_all_kinds_of_arguments_are_timed(monkeypatch):
    found = calls.measure(cold=3, rounds=1)
    assert list(found) == ["arguments", "struct", "struct and array"]
    assert all(seconds > 0.0 for pair in found.values() for seconds in pair)
    monkeypatch.setattr("sys.argv", ["calls.py", "--fast"])
    with pytest.raises(SystemExit, match="unknown argument '--fast'"):
        calls.main()


def test_updates_of_a_standing_robot_are_timed(short_rest):
    updates, cycles, points = estimator.measure("go2", 0.1)
    assert len(updates) == len(cycles) == 50
    assert all(0.0 < update < cycle for update, cycle in zip(updates, cycles, strict=True))
    assert points == 4


def test_cycles_of_a_walk_are_timed_by_kind(short_rest, monkeypatch):
    for name, seconds in (("_STANDING", 0.3), ("_WALKING", 1.5), ("_STOPPING", 0.5)):
        monkeypatch.setattr(walking, name, seconds)
    times = walking.measure("go2", 1)
    assert len(times[walking.STAND]) > 100
    assert len(times[walking.FIRST]) == 4  # sets of supporting feet
    assert len(times[walking.SWITCH]) >= 2
    assert all(value > 0.0 for values in times.values() for value in values)


@pytest.mark.parametrize(("robot", "base", "feet"), [("Go1", "floating", "4 point"), ("UR5", "fixed", "none")])
def test_drafted_robot_passes(monkeypatch, robot, base, feet):
    for name, seconds in (("STAND", 0.5), ("REST", 0.8), ("WALK", 2.5), ("REACHED", 1.8)):
        monkeypatch.setattr(new_robots, name, seconds)
    row = new_robots.run(robot)
    assert (row.kind, row.feet, row.check) == (base, feet, "ok")
    assert (row.stands, row.sway, row.squat, row.push) == ("yes",) * 4
    assert row.walk.endswith("–" if base == "fixed" else " m/s")


def test_robot_on_two_points_cannot_stand():
    row = new_robots.run("Bolt")
    assert (row.check, row.stands) == ("no", "")
    assert "outside the support" in row.to_do


def grown(series: sizes.Series) -> list[tuple[int, object]]:
    """Return our quadratic programs of the two smallest cases and the largest one, with their sizes."""
    assert len(series.cases) >= 4
    made = []
    for size in (*sorted(series.cases)[:2], max(series.cases)):
        settings = parse_settings(series.cases[size], series.title)
        made.append((size, make_qp(settings, make_model(settings))))
    return made


def test_sizes_agree_with_their_axes_and_the_fit_omits_zero(tmp_path):
    for size, qp in grown(sizes.degrees_of_freedom(tmp_path)):
        assert qp.model.nv == size
    for size, qp in grown(sizes.contacts()):
        assert len(qp.contacts) == size
    for size, qp in grown(sizes.tasks()):
        assert len(qp.tasks) == size
    for size, qp in grown(sizes.levels()):
        assert len({task.level for task in qp.tasks.values()}) == size
    for size, qp in grown(sizes.collision_pairs()):
        assert [limit.summary.split()[0] for limit in qp.formulation.row_limits] == ([str(size)] if size else [])
    series = sizes.Series("pairs", {0: {}, 10: {}, 100: {}, 1000: {}})
    for size, blocks in series.seconds.items():
        blocks += [np.full(9, 2.0e-6 * size**0.5 if size else 1.0), np.full(8, 2.0e-6 * size**0.5)]
    assert series.fit() == pytest.approx((0.5, 2.0e-6))


def test_quantiles_are_measured_times_of_solutions():
    seconds = np.arange(1.0, 2001.0)
    np.random.default_rng(0).shuffle(seconds)
    found = summary([seconds[:700], seconds[700:]])
    assert (found.median, found.p99, found.p999) == (1001.0, 1981.0, 1999.0)
    assert found.mean == 1000.5
    assert found.failures == 0
    found = summary([np.array([1.0, np.nan, 3.0]), np.array([np.nan, 2.0])])
    assert (found.median, found.p999, found.failures) == (2.0, 3.0, 2)
    found = summary([np.full(5, np.nan)])
    assert np.isnan(found.median)
    assert found.failures == 5


def test_shares_of_adjacent_blocks_and_fit_of_a_power_law():
    ours = [np.full(9, 1.0), np.full(9, 2.0), np.full(9, 3.0)]
    theirs = [np.full(9, 4.0), np.full(9, 4.0), np.full(9, 30.0)]
    assert share(ours, theirs) == (0.5, 0.1, 0.5)
    unknowns = np.array([18.0, 27.0, 36.0, 50.0])
    assert exponent(unknowns, 3.0e-6 * unknowns**1.3) == pytest.approx((1.3, 3.0e-6))
