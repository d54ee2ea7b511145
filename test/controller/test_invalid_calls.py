"""Calls of the Python API with values of any type: they work, or raise errors of the package."""

import datetime
import fractions
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import wbc_controller as wbc


class NoArray:
    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise RuntimeError("no array")


#: Numbers and arrays that are not real.
REFUSED = [
    1j, [1j] * 3, np.array([1 + 1j, 0, 0]), np.ma.masked_array([0.0, 0.0, 0.7], mask=[1, 0, 0]),
    np.ma.masked_array(np.zeros(19)), np.ma.masked_array(0.5, mask=True), [np.ma.masked_array(0.5, mask=True)] * 3,
    np.nan, np.inf, 1e308, -1e308, 10**400, [1e308] * 3, [1e308] * 18, [1e308] * 19, b"x", object(), NoArray(),
    np.array(["a", "b", "c"]), np.array(["2020-01-01"] * 3, dtype="M8[D]"), datetime.datetime(2020, 1, 1),
    np.zeros((3, 1)), [[1, 2], [3]], lambda: 1, int, {1: 2}, {None: None}, {"FL_hip_joint": 1e308},
    {"FL_hip_joint": 1j}, {"FL_hip_joint": "a"}, {"FL_hip_joint": [1]}, "x", "\ud800",
    pin.SE3(np.eye(3), np.full(3, np.nan)),
]  # fmt: skip
#: Values accepted by some calls.
OTHERS = [None, True, -1.0, "", [], {}, (), set(), [None], np.zeros(0), fractions.Fraction(1, 3), range(3), {"a.b": 1}]

CONFIG = wbc.load("go2")
CONTROLLER = wbc.Controller(CONFIG, preflight=False)
MODEL = CONTROLLER.model
Q, V = CONTROLLER.stance(), np.zeros(MODEL.nv)
JOINTS = dict(zip(MODEL.joints, MODEL.posture.tolist(), strict=True))


def com() -> np.ndarray:
    return CONTROLLER.dynamics.com


def state(**values: Any) -> Any:
    return wbc.state_from_joints(**{"model": MODEL, "positions": JOINTS, **values})


def own(kind: str, value: Any) -> Any:
    return wbc.Controller(CONFIG, preflight=False, model=MODEL, **{kind: value})


#: Calls with one value; the first group refuses all of `REFUSED`.
CALLS: dict[str, Callable[[Any], Any]] = {
    "set com": lambda x: CONTROLLER.set("com", x),
    "set base": lambda x: CONTROLLER.set("base", x),
    "set posture": lambda x: CONTROLLER.set("posture", x),
    "set velocity": lambda x: CONTROLLER.set("com", com(), velocity=x),
    "set acceleration": lambda x: CONTROLLER.set("com", com(), acceleration=x),
    "set duration": lambda x: CONTROLLER.set("com", com(), duration=x),
    "set task": lambda x: CONTROLLER.set(x, com()),
    "follow task": lambda x: CONTROLLER.follow(x, [1.0], [com()]),
    "follow times": lambda x: CONTROLLER.follow("com", x, [com()]),
    "follow time": lambda x: CONTROLLER.follow("com", [x], [com()]),
    "follow positions": lambda x: CONTROLLER.follow("com", [1.0], x),
    "follow position": lambda x: CONTROLLER.follow("com", [1.0], [x]),
    "follow velocities": lambda x: CONTROLLER.follow("com", [1.0], [com()], x),
    "follow velocity": lambda x: CONTROLLER.follow("com", [1.0], [com()], [x]),
    "follow acceleration": lambda x: CONTROLLER.follow("com", [1.0], [com()], None, [x]),
    "enable": CONTROLLER.enable,
    "enable flag": lambda x: CONTROLLER.enable("com", x),
    "disable": CONTROLLER.disable,
    "weight task": lambda x: CONTROLLER.set_weight(x, 1.0),
    "weight": lambda x: CONTROLLER.set_weight("com", x),
    "wrench frame": lambda x: CONTROLLER.set_external_wrench(x, np.zeros(6)),
    "wrench": lambda x: CONTROLLER.set_external_wrench("base", x),
    "reset q": lambda x: CONTROLLER.reset(x, V),
    "reset v": lambda x: CONTROLLER.reset(Q, x),
    "reset t": lambda x: CONTROLLER.reset(Q, V, x),
    "step t": lambda x: CONTROLLER.step(Q, V, x),
    "update": CONTROLLER.update,
    "update value": lambda x: CONTROLLER.update({"tasks.com.stiffness": x}),
    "request": CONTROLLER.request,
    "load": wbc.load,
    "replace": CONFIG.replace,
    "replace weight": lambda x: CONFIG.replace({"tasks.com.weight": x}),
    "replace tasks": lambda x: CONFIG.replace({"tasks": x}),
    "replace task": lambda x: CONFIG.replace({"tasks.com": x}),
    "replace robot": lambda x: CONFIG.replace({"robot": x}),
    "config key": CONFIG.__getitem__,
    "check": wbc.check,
    "controller": wbc.Controller,
    "own tasks": lambda x: own("tasks", x),
    "own task": lambda x: own("tasks", [x]),
    "own contact": lambda x: own("contacts", [x]),
    "own limit": lambda x: own("limits", [x]),
    "plot": wbc.plot,
    "plot result": lambda x: wbc.plot([x]),
    "state model": lambda x: state(model=x),
    "state positions": lambda x: state(positions=x),
    "state velocities": lambda x: state(velocities=x),
    "state quaternion": lambda x: state(base_quaternion=x),
}
#: Calls that accept large numbers or any text.
LENIENT: dict[str, Callable[[Any], Any]] = {
    "step q": lambda x: CONTROLLER.step(x, V, 0.0),
    "step v": lambda x: CONTROLLER.step(Q, x, 0.0),
    "state position": lambda x: state(positions={**JOINTS, "FL_hip_joint": x}),
    "state base": lambda x: state(base_position=x),
    "load URDF": lambda x: wbc.load("go2", urdf=x),
    "replace URDF": lambda x: CONFIG.replace({}, urdf=x),
    "replace posture": lambda x: CONFIG.replace({"robot.posture": x}),
}


@pytest.mark.parametrize("name", [*CALLS, *LENIENT])
def test_a_call_works_or_raises_an_error_of_the_package(name):
    call = {**CALLS, **LENIENT}[name]
    CONTROLLER.reset(Q, V)
    for number, value in enumerate((*REFUSED, *OTHERS)):
        try:
            call(value)
        except wbc.WbcError:
            continue
        assert name in LENIENT or number >= len(REFUSED), f"{value!r} is accepted"
        if name.startswith(("set", "follow", "enable", "disable", "weight", "wrench", "update")):
            results = [CONTROLLER.step(Q, V, CONTROLLER.period * i) for i in range(3)]
            assert {result.mode for result in results} == {wbc.Mode.ACTIVE}
        CONTROLLER.reset(Q, V)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda c: c.set("comm", [0, 0, 0]), "unknown task 'comm'; did you mean 'com'"),
        (lambda c: c.set("com", [0, 0]), r"the position of task 'com' has the shape \(2,\); it takes \(3,\)"),
        (lambda c: c.set("com", [0, 0, np.nan]), "the position of task 'com' is not finite"),
        (lambda c: c.set("com", [0, 0, True]), r"is not an array of numbers: \[0, 0, True\]"),
        (lambda c: c.set("com", "up"), "the position of task 'com' is not an array of numbers"),
        (lambda c: c.set("com", [0, 0, 0], velocity=[1.0]), r"the velocity of task 'com' has shape \(1,\)"),
        (lambda c: c.set("base", [0, 0, 0, 2]), r"the position of task 'base': \[0, 0, 0, 2] is not a unit quaternion"),
        (lambda c: c.set("com", {"FL_hip_joint": 0.0}), "task 'com' has no joints"),
        (lambda c: c.set("posture", {"FL_hip": 0.0}), "'FL_hip' is not a joint of task 'posture'; did you mean"),
        (lambda c: c.follow("com", [0.5, 0.2], np.zeros((2, 3))), "times of task 'com' must increase from at least 0"),
        (lambda c: c.follow("com", [0.5], np.zeros((2, 3))), "2 points for 1 times"),
        (lambda c: c.enable("left_foot"), "unknown task or contact 'left_foot'; did you mean"),
        (lambda c: c.set_weight("com", -1.0), "the weight of task 'com' must be from 0 to 1e.06, not -1.0"),
        (lambda c: c.set_weight("com", np.nan), "must be from 0 to 1e.06, not nan"),
        (lambda c: c.set_external_wrench("bas", np.zeros(6)), "the robot has no such frame; did you mean 'base'"),
        (lambda c: c.step(np.zeros(3), np.zeros(18), 1.0), r"q has shape \(3,\), expected \(19,\)"),
        (lambda c: c.step(["a"] * 19, np.zeros(18), 1.0), r"q is not an array of numbers: \['a', 'a'"),
        (lambda c: c.step(c.stance(), np.zeros(18), -1.0), "t = -1.0 s is before the last step"),
        (lambda c: c.step(c.stance(), np.zeros(18), np.nan), "t must be from -1e.10 to 1e.10, not nan"),
        (lambda c: c.reset(np.full(19, np.nan), np.zeros(18)), "q is not finite"),
        (
            lambda c: c.set("com", [1e308, 0, 0]),
            r"task 'com': a reference is 1e\+308 m; for this robot it must be from -14\.\d+ to 14\.\d+",
        ),
        (lambda c: c.set("com", com() + [0, 15.0, 0]), "task 'com': a reference is 15 m; for this robot"),
        (lambda c: c.set("posture", {"FL_hip_joint": 8.0}), "task 'posture': a reference is 8 rad; for this"),
        (lambda c: c.set("base", [0, 0, 0, 1], velocity=[200.0, 0, 0]), "from -100 to 100"),
        (lambda c: c.set("com", com(), acceleration=[0, 1e300, 0]), r"acceleration is 1e\+300 per s²; for this"),
        (lambda c: c.set("com", com(), duration=1e308), "duration of task 'com' must be from 0 to 86400"),
        (lambda c: c.follow("com", [1e308], [com()]), r"trajectory are \[1e\+308\] s; they must increase"),
        (lambda c: c.follow("com", [1, 1 + 1e-12], [com()] * 2), "must increase from 0 by 0.0001 s or more"),
        (lambda c: c.follow("com", [1, 1.001], [com(), com() + [0, 0, 1.0]]), "velocity is 1000 per s; for"),
        (lambda c: c.set_external_wrench("base", [0, 0, -1e4, 0, 0, 0]), "wrench at 'base' is -1e.04 N, N·m"),
        (lambda c: c.set("com", np.ma.masked_array([0, 0, 1])), "the position of task 'com' is a masked array"),
        (lambda c: c.enable("com", "no"), "enabled = 'no': must be True or False"),
        (lambda c: c.reset(Q, V, 1e308), r"t must be from -1e\+10 to 1e\+10, not 1e\+308"),
    ],
)
def test_an_error_names_the_value_and_its_range_and_has_no_effect(call, sentence):
    CONTROLLER.reset(Q, V)
    before = CONTROLLER.step(Q, V, 0.0)
    with pytest.raises(wbc.InputRefused, match=sentence):
        call(CONTROLLER)
    after = CONTROLLER.step(Q, V, CONTROLLER.period)
    assert after.mode is wbc.Mode.ACTIVE
    assert after.references.weights == before.references.weights
    np.testing.assert_array_equal(after.references.tasks["com"].position, before.references.tasks["com"].position)


def test_a_state_with_absurd_values_leads_to_damping_with_a_reason():
    absurd = [(Q, V + 1e308, "above 1e+09"), (np.zeros(MODEL.nq), V, "not a unit quaternion")]
    for q, v, word in (*absurd, (Q + np.nan, V, "q is not finite: ["), (Q, V + np.nan, "v is not finite: [")):
        CONTROLLER.reset(Q, V)
        result = CONTROLLER.step(q, v, 0.0)
        assert (result.mode, result.fault.code) == (wbc.Mode.DAMPING, "BAD_STATE")
        assert word in result.fault.sentence
        assert np.isfinite(result.tau).all()
        assert result.solution is None
