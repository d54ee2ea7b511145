"""Statistics in the tables of `make bench`."""

import numpy as np
import pytest
from timing import exponent, share, summary


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
    sizes = np.array([18.0, 27.0, 36.0, 50.0])
    assert exponent(sizes, 3.0e-6 * sizes**1.3) == pytest.approx((1.3, 3.0e-6))
