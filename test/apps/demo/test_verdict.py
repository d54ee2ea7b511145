"""Verdict of the demo: a good run meets each target; a bad run misses the one that it violates."""

from dataclasses import replace

import numpy as np
import pytest

from wbc_controller.apps.demo.scenario import Move, Reach, Scenario, Shove, Walk
from wbc_controller.apps.demo.verdict import judge
from wbc_controller.recording.report.run_data import RunData

WEIGHT, START = 100.0, 50.0
SCENARIO = Scenario(
    moves=(Move("sway", ((1.0, (0.0, 0.1, 0.0)), (2.0, (0.0, 0.0, 0.0))), 0.005),),
    reaches=(Reach("hand", (0.1, 0.0, 0.0), 1.0, 0.01),),
    shoves=(Shove("shove left", (0.0, 3.0, 4.0)),),
    recovery=1.0,
)
WINDOWS = {
    "stand": (START + 1.0, START + 2.0),
    "sway": (START + 2.0, START + 4.0),
    "reach hand": (START + 4.0, START + 5.0),
    "shove left": (START + 5.0, START + 7.0),
}
TIME = np.arange(0.0, 8.0, 0.01)
ROWS = {name: (start - START <= TIME) & (end - START >= TIME) for name, (start, end) in WINDOWS.items()}


def good_run():
    n = len(TIME)
    com = np.zeros((n, 3))
    com[ROWS["sway"], 1] = 0.004
    com[ROWS["shove left"], 1] = 0.05
    com[TIME > 5.995, 1] = 0.015
    half = np.zeros((n, 6))
    half[:, 2] = WEIGHT / 2
    half[TIME < 0.9, 2] = 0.0
    tau = np.full((n, 2), 5.0)
    tau[:20] = np.nan  # before the first command
    return RunData(
        robot="x", actuators=("a", "b"), time=TIME, q=np.zeros((n, 9)), tau=tau, effort_limits=np.array([5.0, 10.0]),
        com=com, com_reference=np.zeros((n, 3)), disturbance=np.zeros(n),
        contact_wrenches={"left": half, "right": half}, true_wrenches={"left": half, "right": half}, start=START,
    )  # fmt: skip


RUN = good_run()


def distances(end=0.008):
    """Return the distance of the hand from its target, which is `end` after the reach."""
    distance = np.linspace(0.5, 0.0, len(TIME))
    distance[np.flatnonzero(ROWS["reach hand"])[-1]] = end
    return {"hand": distance}


def verdict(run, windows=WINDOWS, reaches=None, scenario=SCENARIO):
    return {each.name: each for each in judge(run, scenario, windows, reaches or distances(), WEIGHT)}


def missed(run, windows=WINDOWS, reaches=None):
    return {name for name, result in verdict(run, windows, reaches).items() if not result.passed}


def spoiled(array, window, value, column):
    """Return a copy of an array with another value in the middle of a window."""
    result, rows = np.array(array), np.flatnonzero(ROWS[window])
    result[rows[len(rows) // 2], column] = value
    return result


STAND_QP, STAND_SIMULATOR, SWAY, REACH, SHOVE, TORQUE = verdict(RUN)


def test_good_run_meets_all_targets():
    assert len(judge(RUN, SCENARIO, WINDOWS, distances(), WEIGHT)) == 6
    assert missed(RUN) == set()
    said = verdict(RUN)
    assert said[SWAY].measured == "4.00 mm"
    assert said[REACH].measured == "8.00 mm"
    assert said[SHOVE].name == "shove left 5 N·s"
    assert said[SHOVE].measured.startswith("15.00 mm")
    assert said[TORQUE].measured == "100.0 %"


def test_observed_disturbance_counts_only_in_the_program():
    run = replace(RUN, disturbance=np.full(len(TIME), -0.015 * WEIGHT))
    assert missed(run) == {STAND_QP}
    lighter = {name: wrench + [0, 0, 0.0075 * WEIGHT, 0, 0, 0] for name, wrench in run.contact_wrenches.items()}
    assert not missed(replace(run, contact_wrenches=lighter))
    assert missed(replace(run, contact_wrenches=lighter, true_wrenches=lighter)) == {STAND_SIMULATOR}


@pytest.mark.parametrize(("value", "good"), [(49.2, True), (51.1, False), (np.nan, False), (np.inf, False)])
@pytest.mark.parametrize(("field", "name"), [("contact_wrenches", STAND_QP), ("true_wrenches", STAND_SIMULATOR)])
def test_wrong_force_in_one_sample(field, name, value, good):
    left = RUN.contact_wrenches["left"]
    wrenches = {"left": left, "right": spoiled(left, "stand", value, 2)}
    assert missed(replace(RUN, **{field: wrenches})) == (set() if good else {name})


def test_moves_are_judged_by_their_rms_error():
    com = RUN.com.copy()
    com[ROWS["sway"], 1] = 0.0051
    assert missed(replace(RUN, com=com)) == {SWAY}
    assert missed(replace(RUN, com=spoiled(RUN.com, "sway", 0.02, 1))) == set()
    assert missed(replace(RUN, com=spoiled(RUN.com, "sway", np.nan, 1))) == {SWAY}


@pytest.mark.parametrize("value", [0.0101, np.nan])
def test_reaches_are_judged_by_their_end(value):
    assert missed(RUN, reaches=distances(value)) == {REACH}


@pytest.mark.parametrize(("after", "value", "good"), [(0.5, 0.5, True), (1.5, 0.021, False), (1.5, np.nan, False)])
def test_pushes_are_judged_after_the_recovery(after, value, good):
    com = RUN.com.copy()
    com[np.searchsorted(TIME, 5.0 + after), 1] = value
    assert missed(replace(RUN, com=com)) == (set() if good else {SHOVE})


@pytest.mark.parametrize("value", [5.01, -5.01, np.nan, np.inf, -np.inf])
def test_excessive_or_non_finite_torque(value):
    assert missed(replace(RUN, tau=spoiled(RUN.tau, "sway", value, 0))) == {TORQUE}


def test_run_without_torques_fails():
    result = verdict(replace(RUN, tau=np.full_like(RUN.tau, np.nan)))[TORQUE]
    assert (result.passed, result.measured) == (False, "no command")


@pytest.mark.parametrize(
    ("window", "names"),
    [("stand", {STAND_QP, STAND_SIMULATOR}), ("sway", {SWAY}), ("reach hand", {REACH}), ("shove left", {SHOVE})],
)
def test_missing_windows_fail(window, names):
    windows = {name: value for name, value in WINDOWS.items() if name != window}
    assert missed(RUN, windows) == names
    assert all("not reached" in verdict(RUN, windows)[name].measured for name in names)


@pytest.mark.parametrize(("speed", "met"), [(0.3, True), (0.22, False)])
def test_mean_velocity_of_a_walk(speed, met):
    """The velocity counts in the heading of the robot, here to the left of the world."""
    q = np.zeros((len(TIME), 9))
    q[:, 1] = speed * np.minimum(TIME, 6.0)
    q[:, 5:7] = np.sqrt(0.5)
    scenario = Scenario(walks=(Walk("walk", (0.3, 0.0, 0.0)),))
    windows = {"stand": WINDOWS["stand"], "walk": (START + 3.0, START + 6.0), "stop": (START + 7, START + 8)}
    found = verdict(replace(RUN, q=q), windows, scenario=scenario)
    assert found["walk"].passed is met
    assert found["walk"].measured == f"{speed:.3f}, 0.000, 0.000"
    assert found["stop"].passed
    found = verdict(RUN, {"stand": WINDOWS["stand"]}, scenario=scenario)
    assert found["walk"].measured == found["stop"].measured == "not reached"
    assert not found["stop"].passed
