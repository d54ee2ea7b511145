"""Row kernels beside `test_plain_qp`: references, rotations, and what is not compiled."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from snapshots import close, dynamics_at

from wbc_controller.inverse_dynamics.contacts import PointContact
from wbc_controller.inverse_dynamics.formulation.rows import CompiledRows, RowEntry
from wbc_controller.inverse_dynamics.robot import frame_kernels as kernel
from wbc_controller.inverse_dynamics.robot.dynamics import view_of
from wbc_controller.inverse_dynamics.tasks import ComTask, FrameOrientationTask, FramePositionTask, PostureTask
from wbc_controller.records import Reference, frozen


def moved(model, seed):
    """Return a robot's dynamics far from rest."""
    rng, robot = np.random.default_rng(seed), model.pinocchio
    q = pin.integrate(robot, pin.neutral(robot), rng.normal(size=model.nv))
    return dynamics_at(model, q, 3.0 * rng.normal(size=model.nv)), rng


def compiled(dynamics, task):
    """Return the rows of a task, (k, nv + 1), and the block that fills them."""
    out = np.zeros((task.dimension, dynamics.model.nv + 1))
    return out, CompiledRows(dynamics, out, np.zeros(out.shape[1]), [RowEntry(task.instruction(), task=task)])


def fill(block, dynamics, task, wanted):
    """Fill the rows of a task; return its errors."""
    errors = np.empty(task.dimension)
    block.set_gains()
    block.set_references({task.name: wanted})
    kernel.fill_rows(block.arrays, dynamics.q, dynamics.v, errors)
    return errors


def test_writable_references_are_read_in_every_cycle(g1):
    dynamics, _ = moved(g1, 5)
    task, position = ComTask("com", [True] * 3), np.zeros(3)
    for fixed in (False, True):
        wanted = Reference(*(frozen(part) if fixed else part for part in (position, np.zeros(3), np.zeros(3))))
        out, block = compiled(dynamics, task)
        fill(block, dynamics, task, wanted)
        before = out[:, -1].copy()
        position += 1.0
        fill(block, dynamics, task, wanted)
        close(out[:, -1] - before, np.zeros(3) if fixed else task.stiffness * np.ones(3), 1e-10)
        task.stiffness = 2.0 * task.stiffness  # gains are read in every cycle
        fill(block, dynamics, task, wanted)
        close(out[:, -1], task.equation(dynamics, wanted)[1], 1e-10)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    angle=st.one_of(st.floats(0.0, 3.141592), st.floats(0.0, 1e-6), st.floats(3.1415, 3.14159265)),
)
def test_rotation_error_equals_axis_and_angle(g1, seed, angle):
    dynamics, rng = moved(g1, seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    task = FrameOrientationTask("task", dynamics.model, "pelvis")
    rotation = pin.exp3(angle * axis) @ dynamics.placement(task._frame_id).rotation
    wanted = pin.Quaternion(rotation).coeffs() * rng.choice([1.0, -1.0, 0.995])
    _, block = compiled(dynamics, task)
    error = fill(block, dynamics, task, Reference(wanted, np.zeros(3), np.zeros(3)))
    np.testing.assert_allclose(error, angle * axis, atol=1e-9 if angle < 3.1 else 1e-7)


@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_link_motion_views_pinocchio_vectors(robot_of, robot):
    dynamics, _ = moved(robot_of(robot)[1], 1)
    data, motion = dynamics._data, dynamics.motion
    for number, placement in enumerate(data.oMi):
        np.testing.assert_array_equal(dynamics.joints[number], [*placement.rotation.T.ravel(), *placement.translation])
    tables = (data.v, motion.local_twists), (data.a_gf, motion.local_accelerations), (data.f, motion.wrenches)
    for parts, rows in tables:
        np.testing.assert_array_equal([part.vector for part in parts], rows)
    assert not dynamics.joints.flags.writeable


def test_what_is_not_compiled_and_non_contiguous_vectors(g1):
    ball = "left_rubber_hand", np.zeros(3), 0.02
    for kind, arguments in ((FramePositionTask, ["left_rubber_hand"]), (PostureTask, ()), (PointContact, ball)):
        assert kind("own", g1, *arguments).instruction() is not None
        assert type("Own", (kind,), {})("own", g1, *arguments).instruction() is None
    assert PointContact("between", g1, *ball, against="left_ankle_roll_link").instruction() is None
    with pytest.raises(RuntimeError, match="does not store vectors of 3 numbers contiguously"):
        view_of(list(np.zeros((3, 4))[:, :3]), 3)
