"""Kernels refuse arrays of inconsistent sizes."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.estimation import invariant_filter_kernels as invariant_filter
from wbc_controller.inverse_dynamics.limits import JointMotionLimit
from wbc_controller.records import RobotState
from wbc_controller.safety.plausibility_kernels import SampleMemory, compare_sample
from wbc_controller.walking import feet_kernels as feet
from wbc_controller.walking import references_kernels as references

N = 3


def of(*shape):
    return np.zeros(shape)


def filter_state(points=1):
    return of(3, 3), of(3, 2 + points), of(3), of(3), np.eye(15 + 3 * points)


def propagated(gravity, velocity, force, noise, creep):
    arrays = of(gravity), of(velocity), of(force)
    invariant_filter.propagate(*filter_state(), *arrays, 0.002, of(noise), of(creep))


def corrected(points, places, end):
    covariance = np.eye(3 * len(points))
    invariant_filter.correct(*filter_state(), np.array(points), np.array([end]), places, covariance)


PLACEMENT = np.append(np.eye(3).ravel(), np.zeros(3))


def moved_sole(rows, mount, written, size):
    numbers = (0j, 0.0, 0.0, 0.5, 0.1, 0.0, 0.05, 0.1, 0.002, 0.06, 0.0, 0j, 0j)
    feet.move_sole(of(rows, 4), *numbers, PLACEMENT[:mount], of(written, 4), of(size))


def motion_of_points(links, on, points, out):
    feet.motion_of_points(of(2, 12), of(links, 6), np.array([on]), of(points, 3), of(out, 6))


def motion_of_sole(links, i, mount):
    feet.motion_of_sole(np.array(2 * [PLACEMENT]), of(links, 6), i, PLACEMENT[:mount])


def body_references(size, out):
    references.body_references(0j, 0j, 0j, 0.8, 0.8, 0.0, 0.0, 0.002, of(1, size), of(out))


def compared(measured, size):
    limits = dict.fromkeys(("fastest", "velocity_step", "tolerance"), of(N))
    last = {"position": of(N), "velocity": of(N), "change": of(N)}
    memory = SampleMemory(floating=False, measured=measured, magnitude=1.0, **limits, **last)
    assert compare_sample(memory, of(N), of(size), 0.0) == -1


def bounds(q, v):
    JointMotionLimit((-np.ones(N), np.ones(N)), None, acceleration=10.0).bounds(of(q), of(v), 0.002)


#: A call with consistent sizes, and calls with inconsistent ones.
CALLS = {
    "propagate": (propagated, (3, 3, 3, 4, 1),
        [(2, 3, 3, 4, 1), (3, 2, 3, 4, 1), (3, 3, 2, 4, 1), (3, 3, 3, 5, 1), (3, 3, 3, 4, 2)]),
    "correct": (lambda point, places, end: corrected([point], of(places, 3), end), (0, 1, 1),
        [(1, 1, 1), (-1, 1, 1), (0, 0, 1), (0, 1, 2)]),
    "motion_of_points": (motion_of_points, (2, 1, 1, 1), [(3, 1, 1, 1), (2, 2, 1, 1), (2, 1, 2, 1), (2, 1, 1, 2)]),
    "motion_of_sole": (motion_of_sole, (2, 1, 12), [(3, 1, 12), (2, 2, 12), (2, -1, 12), (2, 1, 7)]),
    "move_sole": (moved_sole, (3, 12, 3, 19), [(2, 12, 3, 19), (3, 7, 3, 19), (3, 12, 2, 19), (3, 12, 3, 18)]),
    "body_references": (body_references, (4, 16), [(3, 16), (4, 15)]),
    "compare_sample, measured": (partial(compared, True), (N,), [(0,), (N + 1,)]),
    "compare_sample": (partial(compared, False), (0,), [(1,), (N + 1,)]),
    "acceleration_bounds": (bounds, (N, N), [(N, N - 1), (N - 1, N), (N + 1, N + 1), (N - 1, N - 1)]),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_sizes_that_do_not_agree_are_refused(name):
    call, sizes, others = CALLS[name]
    call(*sizes)
    for wrong in others:
        with pytest.raises((ValueError, IndexError)):
            call(*wrong)


@pytest.fixture(scope="module")
def program(robot_of, stance_of):
    settings, model = robot_of("go2")
    qp, q = make_qp(settings, model), stance_of("go2")
    qp.dynamics.update(q, np.zeros(model.nv))
    board = make_board(settings, qp)
    board.reset(qp.dynamics, 0.0)
    return qp, RobotState(0, q, np.zeros(model.nv)), board.sample(1.0)


@pytest.mark.parametrize("size", [0, 11, 13])
def test_torques_before_of_another_size_are_refused(program, size):
    qp, state, references = program
    qp.solve(state, references, of(qp.model.na))
    with pytest.raises(ValueError, match="the size of tau_before differs"):
        qp.solve(state, references, of(size))


@pytest.mark.parametrize("frame", [-1, 10**6])
def test_a_frame_that_the_model_does_not_have_is_refused(program, frame):
    axes = {"placement": (), "velocity": (pin.LOCAL,), "jacobian": (pin.LOCAL,), "drift_local": (), "drift_world": ()}
    for name, arguments in axes.items():
        with pytest.raises(IndexError, match=f"invalid frame id {frame}: the model has"):
            getattr(program[0].dynamics, name)(frame, *arguments)
