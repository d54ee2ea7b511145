"""Cases with one varying size of the problem."""

import numpy as np
import pytest
import sizes
from our_cycle import make_model, parse_settings

from wbc_controller.controller.build.program import make_qp


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
