"""Conversion of quaternions and rotation matrices."""

from pathlib import Path

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st

import wbc_controller
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.validation.fuzz.hostile_messages import memory

turns = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@given(turns)
def test_round_trip(turn):
    R = pin.exp3(turn)
    q = quaternion_of(R)
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotation_of(q), R, atol=1e-12)
    np.testing.assert_allclose(rotation_of(-3.0 * q), R, atol=1e-12)


def test_only_orientation_converts_and_the_scalar_comes_last():
    np.testing.assert_allclose(quaternion_of(np.diag([1.0, -1.0, -1.0])), [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(quaternion_of(np.eye(3)), [0.0, 0.0, 0.0, 1.0])
    package = Path(wbc_controller.__file__).parent
    users = [path.name for path in package.rglob("*.py") if "pin.Quaternion(" in path.read_text(encoding="utf-8")]
    assert users == ["orientation.py"]


def test_no_memory_leak():
    R = pin.exp3(np.array([0.1, -0.2, 0.3]))
    for _ in range(1000):
        rotation_of(quaternion_of(R))
    before, count = memory(), 50_000
    for _ in range(count):
        rotation_of(quaternion_of(R))
    assert 1024 * (memory() - before) / count < 10.0  # bytes; pin.Quaternion(R) leaks 80
