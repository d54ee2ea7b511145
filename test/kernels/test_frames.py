"""Held against Pinocchio's own functions, and against the same equations in NumPy."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.assembly.robot import make_model
from wbc_controller.core.contacts import PointContact
from wbc_controller.core.contacts.mount import Mount
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.tasks import FrameOrientationTask, FramePoseTask, FramePositionTask
from wbc_controller.kernels import frames as kernel
from wbc_controller.records import Reference
from wbc_controller.settings.files import find_configuration, load_settings

AXES = pin.LOCAL_WORLD_ALIGNED
ROBOTS = {name: Dynamics(make_model(load_settings(find_configuration(name)))) for name in ("g1", "talos", "go2")}
FRAMES = {"g1": ("left_rubber_hand", "pelvis", "left_ankle_roll_link", "universe"),
          "talos": ("left_sole_link", "base_link", "torso_2_link", "universe"),
          "go2": ("FL_foot", "base", "RR_calf", "universe")}  # fmt: skip
seeds = st.integers(0, 2**32 - 1)


def moved(robot, seed):
    """A robot's terms at a state far from rest."""
    dynamics, rng = ROBOTS[robot], np.random.default_rng(seed)
    model = dynamics.model.pinocchio
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    dynamics.update(q, 3.0 * rng.normal(size=model.nv))
    return dynamics, rng


def near(found, expected):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * max(1.0, float(np.abs(expected).max(initial=0))))


@pytest.mark.parametrize("robot", ROBOTS)
@settings(deadline=None)
@given(seed=seeds)
def test_tasks_on_frames_have_the_rows_that_pinocchio_gives(robot, seed):
    dynamics, rng = moved(robot, seed)
    mask = rng.random(6) < 0.7
    for frame in FRAMES[robot]:
        for kind in (FramePositionTask, FrameOrientationTask, FramePoseTask):
            size = kind.size
            chosen = mask[:size] if mask[:size].any() else np.ones(size, dtype=bool)
            gains = rng.uniform(1.0, 100.0, (2, size))
            task = kind("task", dynamics.model, frame, chosen, stiffness=gains[0], damping=gains[1])
            there = pin.SE3.Random() if rng.random() < 0.8 else dynamics.placement(task._frame_id)
            pose = pin.SE3ToXYZQUAT(there)
            wanted = Reference(
                {0: pose[:3], 3: pose[3:]}[kind.part.start] if size == 3 else pose, *rng.normal(size=(2, size))
            )
            rows, right, error = task.equation(dynamics, wanted)
            displaced = task.error(dynamics, wanted.position)
            asked = gains[0] * displaced + gains[1] * (wanted.velocity - task.velocity(dynamics))
            asked += wanted.acceleration - task.drift(dynamics)
            near(rows, task.jacobian(dynamics)[chosen])
            if np.pi - np.linalg.norm(displaced[-3:]) > 1e-6:  # else the axis may point either way
                near(error, displaced[chosen])
                near(right, asked[chosen])


@pytest.mark.parametrize("robot", ROBOTS)
@settings(deadline=None)
@given(seed=seeds, between_links=st.booleans())
def test_contacts_have_the_rows_that_pinocchio_gives(robot, seed, between_links):
    dynamics, _ = moved(robot, seed)
    model, mount = dynamics.model, pin.SE3.Random()
    frame, other = FRAMES[robot][0], FRAMES[robot][2]
    contact = Mount(model, "contact", frame, mount, other if between_links else None)
    here, X = model.frame_id(frame, ""), mount.inverse().toActionMatrix()
    J, nu = X @ dynamics.jacobian(here, pin.LOCAL), X @ dynamics.velocity(here, pin.LOCAL)
    drift = X @ dynamics.drift_local(here)
    if between_links:
        there = model.frame_id(other, "")
        X = (dynamics.placement(here) * mount).actInv(dynamics.placement(there)).toActionMatrix()
        carried = X @ dynamics.velocity(there, pin.LOCAL)
        J, drift = J - X @ dynamics.jacobian(there, pin.LOCAL), drift - X @ dynamics.drift_local(there)
        drift += pin.Motion(nu - carried).cross(pin.Motion(carried)).vector
    near(contact.jacobian(dynamics), J)
    near(contact.drift(dynamics), drift)


@pytest.mark.parametrize("robot", ROBOTS)
@settings(deadline=None)
@given(seed=seeds, radius=st.floats(0.0, 0.2))
def test_balls_have_the_rows_that_pinocchio_gives(robot, seed, radius):
    dynamics, rng = moved(robot, seed)
    normal, centre = rng.normal(size=3), rng.normal(size=3)
    for frame in FRAMES[robot]:
        contact = PointContact("contact", dynamics.model, frame, centre, radius, normal=normal)
        J, acceleration = np.empty((3, dynamics.model.nv)), np.empty(3)
        contact.fill(dynamics, J, acceleration)
        near(J, contact.jacobian(dynamics))
        near(acceleration, -contact.drift(dynamics))


@settings(deadline=None)
@given(seed=seeds, angle=st.one_of(st.floats(0.0, 3.141592), st.floats(0.0, 1e-6), st.floats(3.1415, 3.14159265)))
def test_the_rotation_vector_to_a_reference_is_that_of_the_angle(seed, angle):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    present = pin.SE3.Random()
    wanted = pin.Quaternion(pin.exp3(angle * axis) @ present.rotation).coeffs() * rng.choice([1.0, -1.0, 0.995])
    placement, error = np.concatenate([present.rotation.T.ravel(), present.translation]), np.empty(3)
    still, nothing = np.zeros(3), np.zeros((1, 1), dtype=np.int8)
    kernel.frame_task(
        placement[None], np.zeros((1, 12)), np.zeros((6, 1)), nothing, 0, 0, 3, np.arange(3), np.ones((2, 3)),
        wanted, still, still, np.empty((3, 1)), np.empty(3), error,
    )  # fmt: skip
    np.testing.assert_allclose(error, angle * axis, atol=1e-9 if angle < 3.1 else 1e-7)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_tables_are_pinocchios_own_memory(robot):
    dynamics, _ = moved(robot, 1)
    for number, placement in enumerate(dynamics._data.oMf):
        np.testing.assert_array_equal(dynamics.frames[number], [*placement.rotation.T.ravel(), *placement.translation])
    joint_motions = zip(dynamics._data.v, dynamics._data.a, *dynamics._joint_motions, strict=True)
    for v, a, v_row, a_row in joint_motions:
        np.testing.assert_array_equal(v.vector, v_row)
        np.testing.assert_array_equal(a.vector, a_row)
    assert not dynamics.frames.flags.writeable
