"""`test/middleware/test_in_place.py` holds the kernel that reads messages against the codec; here is what is left."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.compiled import Bound
from wbc_controller.inverse_dynamics.tasks.form import unit_quaternion
from wbc_controller.middleware import message_kernels as kernel


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: math.hypot(*q) > 0.1))
def test_a_quaternion_is_normalized_as_in_setpoints(quaternion):
    values = np.array([7.0, *quaternion])
    norm = kernel.normalize(values, 1)
    assert math.isclose(norm, math.hypot(*quaternion), rel_tol=1e-14)
    np.testing.assert_allclose(values[1:], unit_quaternion(np.array(quaternion) / norm, ""), rtol=1e-14, atol=1e-16)
    assert values[0] == 7.0


def test_a_state_is_assembled_as_by_the_model(robot_of):
    rng = np.random.default_rng(3)
    for robot in ("g1", "go2", "talos"):
        model = robot_of(robot)[1]
        positions, velocities = rng.normal(size=(2, model.nj))
        pose, twist = rng.normal(size=7), rng.normal(size=6)
        q, v = np.full(model.nq, np.nan), np.full(model.nv, np.nan)
        places = Bound(model.nj, model.q_index.astype(np.int64), model.v_index.astype(np.int64))
        kernel.assemble(places.table, positions, velocities, pose, twist, q, v)
        if model.followers is not None:
            model.followers.place(q)
            model.followers.move(v)
        expected = model.state(positions, velocities, pose, twist)
        assert (q.tobytes(), v.tobytes()) == (expected[0].tobytes(), expected[1].tobytes())
