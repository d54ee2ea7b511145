"""The data of a report: shapes, copies, and values that are refused."""

import dataclasses

import numpy as np
import pytest
from synthetic_run import squat

from wbc_controller.recording.report.run_data import supports_of
from wbc_controller.settings.files import find_configuration, load_settings


@pytest.fixture(scope="module")
def run():
    return squat("g1", duration=2.0, rate=50.0)[0]


def test_arrays_are_frozen_copies(run):
    time = np.array(run.time)
    copy = dataclasses.replace(run, time=time)
    time[0] = -5.0
    assert copy.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        copy.tau[0, 0] = 1.0
    with pytest.raises(TypeError):
        copy.friction["left_foot"] = 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"com": np.zeros((3, 3))}, r"com has the shape \(3, 3\); it must be \(100, 3\)"),
        ({"time": np.full(100, np.nan)}, "time must be finite"),
        ({"time": np.arange(100.0)[::-1]}, "never decrease"),
        ({"q": np.full((100, 36), np.inf)}, "q contains values that are not finite"),
        ({"contact_wrenches": {"left_foot": np.zeros((100, 4))}}, r"contact_wrenches\['left_foot'\] has 4 columns"),
        ({"stage_seconds": {"solver": np.zeros(7)}}, r"stage_seconds\['solver'\] has the shape"),
    ],
)
def test_refuses_what_does_not_fit(run, changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(run, **changes)


def test_refuses_an_empty_run(run):
    n = {name: getattr(run, name)[:0] for name in ("time", "q", "tau", "com", "com_reference", "disturbance")}
    empty = {name: {} for name in ("task_errors", "contact_wrenches", "true_wrenches")}
    with pytest.raises(ValueError, match="at least one sample"):
        dataclasses.replace(run, **n, **empty)


def test_supports_of_surfaces_and_points():
    foot = supports_of(load_settings(find_configuration("g1")).contacts)["left_foot"]
    np.testing.assert_allclose(foot.placement, [0.035, 0.0, -0.035, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.ptp(foot.corners, axis=0), [0.17, 0.05, 0.0])
    paw = supports_of(load_settings(find_configuration("go2")).contacts)["front_left_foot"]
    np.testing.assert_array_equal(paw.corners, [[0.0, 0.0, 0.0]])
