"""Statistics in the tables of `make bench`."""

import numpy as np
import pytest
from timing import exponent, share, summary


def test_quantiles_are_measured_times():
    seconds = np.arange(1.0, 2001.0)
    np.random.default_rng(0).shuffle(seconds)
    found = summary([seconds[:700], seconds[700:]])
    assert (found.median, found.p99, found.p999) == (1001.0, 1981.0, 1999.0)
    assert found.mean == 1000.5
    assert found.failures == 0


def test_cycles_without_a_solution_are_counted_and_not_timed():
    found = summary([np.array([1.0, np.nan, 3.0]), np.array([np.nan, 2.0])])
    assert (found.median, found.p999, found.failures) == (2.0, 3.0, 2)


def test_contestant_without_solutions_has_no_times():
    found = summary([np.full(5, np.nan)])
    assert np.isnan(found.median)
    assert found.failures == 5


def test_share_and_its_range_over_adjacent_blocks():
    ours = [np.full(9, 1.0), np.full(9, 2.0), np.full(9, 3.0)]
    theirs = [np.full(9, 4.0), np.full(9, 4.0), np.full(9, 30.0)]
    assert share(ours, theirs) == (0.5, 0.1, 0.5)


def test_fit_of_a_power_law():
    sizes = np.array([18.0, 27.0, 36.0, 50.0])
    assert exponent(sizes, 3.0e-6 * sizes**1.3) == pytest.approx((1.3, 3.0e-6))
