"""Arrays whose sizes do not agree are refused by compiled functions: they would read or write beyond them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import wbc_controller as wbc
from wbc_controller.compiled import Bound
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board_plan
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.estimation import invariant_filter_kernels as invariant_filter
from wbc_controller.estimation import leg_kinematics_kernels as leg_kinematics
from wbc_controller.inverse_dynamics.formulation import residual_kernels
from wbc_controller.inverse_dynamics.limits import JointMotionLimit
from wbc_controller.inverse_dynamics.limits import self_collision_kernels as self_collision
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import acceleration_bounds
from wbc_controller.inverse_dynamics.references.board import ReferenceBoard
from wbc_controller.inverse_dynamics.robot import frame_kernels as frames
from wbc_controller.records import Reference, RobotState
from wbc_controller.safety import model_audit_kernels as audit
from wbc_controller.safety import supervisor_kernels as supervision

N = 3


def of(*shape):
    return np.zeros(shape)


def filter_state(points=1):
    return of(3, 3), of(3, 2 + points), of(3), of(3), np.eye(15 + 3 * points)


def propagated(before, after, *, force=3):
    kept = after[0], after[1], after[4]
    invariant_filter.propagate(*before, of(3), of(3), of(force), 0.002, of(5), *kept)


def corrected(points, places, *, squares=1):
    ends, covariance = np.array([len(points)]), of(3 * len(points), 3 * len(points))
    limits = np.ones(1)
    invariant_filter.correct(
        *filter_state(), np.array(points), ends, places, covariance, limits, of(squares), *filter_state()
    )


def sighted(places=2, velocity=7, rates=2):
    leg_kinematics.sights(
        of(2, 12), of(6, 7), np.zeros((2, 7), dtype=np.int8), np.array([1]), 0, of(12), np.array([2]), of(2, 3),
        of(velocity), 0.1, 0.1, of(places, 3), of(6, 6), of(1, 3), of(rates, 3),
    )  # fmt: skip


def slowest(velocity=3, rates=2, radii=1, mean=1):
    leg_kinematics.slowest_contact(
        np.eye(3), of(velocity), of(3), of(12), of(6), of(2, 3), of(rates, 3), np.array([2]), of(1, 3),
        of(radii, 3), 0.1, 1.0, of(mean, 3),
    )  # fmt: skip


def energy(nv, velocity):
    audit.mechanical_energy(Bound(nv, 0, 0, 0, of(N, N), of(3), of(3)).table, of(velocity))


def bounded(joints, lower):
    each = np.arange(joints)
    JointMotionLimit((-np.ones(N), np.ones(N)), None, acceleration=10.0).bind(each, each, 0.002, of(lower), of(lower))


def followed(tau, out):
    each = np.arange(N)
    own = Bound(N, N, np.ones(N), np.ones(N), each, each, np.stack([-np.ones(N), np.ones(N)]), np.ones(2))
    tables = Bound(0, 0, own.table)
    supervision.supervised(tables.table, of(N), of(N), np.nan, False, of(tau), of(N), of(N), 1.0, 0.0, 0.002, of(out))


#: A call with sizes that agree, and calls with others.
CALLS = {
    "feedback": (
        lambda *n: frames.feedback(of(n[0]), of(n[1]), of(n[2]), np.ones((2, n[3])), of(n[4]), of(n[5]), of(n[6])),
        (1,) * 7,
        [(size, *(1,) * 6) for size in (2, 50, 1000)] + [tuple(1 + (i == k) for i in range(7)) for k in range(7)],
    ),
    "limited": (
        lambda *n: supervision.limited(of(n[0]), of(n[1]), of(n[2]), 0.1, of(n[3]), of(n[4]), of(n[5])),
        (N,) * 6,
        [tuple(N - (i == k) for i in range(6)) for k in range(6)],
    ),
    "within": (lambda *n: supervision.within(of(n[0]), of(n[1])), (N, N), [(N, N - 1)]),
    "upward": (lambda n: supervision.upward(of(n)), (7,), [(6,), (0,)]),
    "height": (
        lambda q, points: supervision.height(
            of(q), np.zeros(1, dtype=np.int64), of(1, 12), of(1, 6), np.zeros(2, dtype=np.int64), of(points, 3)
        ),
        (8, 2),
        [(7, 2), (8, 1)],
    ),
    "acceleration_apart": (
        lambda *n: self_collision.acceleration_apart(of(n[0]), of(n[1]), 0.0, 1.0, 0.1, 0.1, 1.0, of(n[2])),
        (N, N, N),
        [(N, 1, N), (N, N, 1)],
    ),
    "residuals": (
        lambda rows, bounds, offset, found: residual_kernels.residuals(
            of(rows, N + 1), of(2, bounds), of(offset), of(found)
        ),
        (4, N + 2, 1, 4 * (N + 2) + 2 + 1),
        [(3, N + 2, 1, 4 * (N + 2) + 2 + 1), (4, N + 3, 1, 4 * (N + 2) + 2 + 1), (4, N + 2, 1, 4 * (N + 2))],
    ),
    "propagate": (
        lambda after, force: propagated(filter_state(), filter_state(after), force=force), (1, 3), [(2, 3), (1, 2)]
    ),
    "correct": (
        lambda point, places, squares: corrected([point], of(places, 3), squares=squares),
        (0, 1, 1),
        [(1, 1, 1), (-1, 1, 1), (0, 0, 1), (0, 1, 0)],
    ),
    "sights": (sighted, (2, 7, 2), [(1, 7, 2), (2, 6, 2), (2, 7, 1)]),
    "slowest_contact": (slowest, (3, 2, 1, 1), [(2, 2, 1, 1), (3, 1, 1, 1), (3, 2, 2, 1), (3, 2, 1, 2)]),
    "mechanical_energy": (energy, (N, N), [(N, N - 1), (N + 1, N + 1)]),
    "supervised": (followed, (N, 3 * N), [(N - 1, 3 * N), (N, 3 * N - 1)]),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_sizes_that_do_not_agree_are_refused(name):
    call, sizes, others = CALLS[name]
    call(*sizes)
    for wrong in others:
        with pytest.raises((ValueError, IndexError)):
            call(*wrong)


def test_joints_beyond_a_state_are_refused():
    limit = JointMotionLimit((-np.ones(N), np.ones(N)), None, acceleration=10.0)
    limit.bounds(of(N), of(N), 0.002)
    for q, v in ((N, N - 1), (N - 1, N), (N + 1, N + 1), (N - 1, N - 1)):
        with pytest.raises((ValueError, IndexError)):
            limit.bounds(of(q), of(v), 0.002)


@pytest.mark.parametrize("array", [of(5), of(2, 4), np.zeros(6, dtype=np.int64), np.zeros(6, dtype=np.int8), 0])
def test_a_table_with_another_array_than_is_expected_is_refused(array):
    good = 1, 1, 1, np.arange(1), np.arange(1), of(2, 1), np.ones(1), np.ones(7), of(1), of(1)
    acceleration_bounds(Bound(*good).table, of(1), of(1))
    for place in range(3, len(good)):
        with pytest.raises(ValueError, match="another size or type"):
            acceleration_bounds(Bound(*good[:place], array, *good[place + 1 :]).table, of(1), of(1))


def test_a_table_has_no_more_entries_than_compiled_functions_read():
    with pytest.raises(ValueError, match="at most 32 entries"):
        Bound(*range(33))


@pytest.fixture(scope="module")
def program():
    config = wbc.load("go2").settings
    model = make_model(config)
    qp = make_qp(config, model)
    active = [name for name, contact in config.contacts.items() if contact.enabled]
    q = stance(model, qp, active)
    qp.dynamics.update(q, np.zeros(model.nv))
    board = ReferenceBoard(make_board_plan(config, qp))
    board.reset(qp.dynamics, 0.0)
    return qp, RobotState(0, q, np.zeros(model.nv)), board.sample(1.0)


@pytest.mark.parametrize("size", [0, 11, 13])
def test_torques_before_of_another_size_are_refused(program, size):
    qp, state, references = program
    qp.solve(state, references, of(qp.model.na))
    with pytest.raises(ValueError, match="the torques before have another size"):
        qp.solve(state, references, of(size))


@pytest.mark.parametrize("part", ["position", "velocity", "acceleration"])
def test_a_reference_of_another_size_is_refused(program, part):
    qp, state, references = program
    com = references.tasks["com"]
    arrays = {each: getattr(com, each) for each in ("position", "velocity", "acceleration")}
    wrong = Reference(**{**arrays, part: of(2)})
    tasks = {**references.tasks, "com": wrong}
    with pytest.raises(ValueError, match="the reference of task 'com' has"):
        qp.solve(state, replace(references, tasks=tasks))


@pytest.mark.parametrize("frame", [-1, 10**6])
def test_a_frame_that_the_model_does_not_have_is_refused(program, frame):
    dynamics = program[0].dynamics
    calls = (
        lambda: dynamics.placement(frame),
        lambda: dynamics.velocity(frame, pin.LOCAL),
        lambda: dynamics.jacobian(frame, pin.LOCAL),
        lambda: dynamics.drift_local(frame),
        lambda: dynamics.drift_world(frame),
    )
    for call in calls:
        with pytest.raises(IndexError, match=f"frame {frame}, but the model has"):
            call()
