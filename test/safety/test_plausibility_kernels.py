"""Comparisons of states: equal to the same equations in NumPy."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.safety import plausibility_kernels as kernels
from wbc_controller.safety.plausibility_kernels import compare

N, NV = 12, 18
seeds = st.integers(0, 2**32 - 1)


class Watched:
    """Two states of a free flyer with unordered joints and a follower, and the memory."""

    def __init__(self, seed, *, floating=True):
        rng = self.rng = np.random.default_rng(seed)
        self.floating, self.nv = floating, NV if floating else N
        first = 6 if floating else 0
        self.v_index = first + rng.permutation(N)[:11]
        self.q_index = self.v_index + (1 if floating else 0)
        self.before, self.q = (self.configuration(rng.normal(size=self.nv)) for _ in range(2))
        self.v_before, self.v = rng.normal(size=(2, self.nv))
        self.dt, self.magnitude = 0.004, 100.0
        self.limits = np.full((3, self.nv), np.inf)
        self.mismatch, self.stuck_motion = rng.normal(size=(2, self.nv))

    def configuration(self, motion):
        if not self.floating:
            return motion
        turn = pin.SE3ToXYZQUAT(pin.exp6(pin.Motion(motion[:6])))
        return np.concatenate([turn, motion[6:]])

    def change(self):
        """Return Pinocchio's order."""
        joints = self.q[-N:] - self.before[-N:]
        if not self.floating:
            return joints
        model = pin.Model()
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        return np.concatenate([pin.difference(model, self.before[:7], self.q[:7]), joints])

    def compare(self):
        kept = [each.copy() for each in (self.before, self.v_before)]
        memory = kernels.StateMemory(
            q_index=self.q_index,
            v_index=self.v_index,
            base_q=np.arange(7 if self.floating else 0),
            base_v=np.arange(6 if self.floating else 0),
            magnitude=self.magnitude,
            fastest=self.limits[0],
            tolerance=self.limits[1],
            stuck_limit=self.limits[2],
            before=kept[0],
            v_before=kept[1],
            mismatch=self.mismatch,
            stuck_motion=self.stuck_motion,
        )
        found = compare(memory, self.q, self.v, self.dt)
        expected = [self.before, self.v_before] if found & kernels.OUT_OF_RANGE else [self.q, self.v]
        assert all(each.tobytes() == other.tobytes() for each, other in zip(kept, expected, strict=True))
        return found

    def expect(self):
        """Return findings, mismatch and stuck motion by NumPy."""
        fastest, tolerance, stuck_limit = self.limits
        x, u = self.mismatch, self.stuck_motion
        if not (np.abs(self.q) <= self.magnitude).all() or not (np.abs(self.v) <= fastest).all():
            return kernels.OUT_OF_RANGE, x, u
        change, integrated = self.change(), 0.5 * self.dt * (self.v_before + self.v)
        known, keep = 0.0 <= self.dt <= kernels.GAP, 1.0 - self.dt / kernels.MEMORY
        reach = abs(self.dt) * fastest
        x = keep * x + (change - integrated) if known else change - np.clip(change, -reach, reach)
        found = 0
        if not (np.abs(x) <= tolerance).all():
            found, u = found | kernels.JUMPED, np.zeros(self.nv)
        if change[self.v_index].all():
            u = np.zeros(self.nv)
        else:
            if known:
                u = np.where(change == 0.0, keep * u + integrated, 0.0)
                found |= 0 if (np.abs(u) <= stuck_limit).all() else kernels.STUCK
            found |= kernels.JOINTS_REPEAT if self.repeats(self.q_index, self.v_index) else 0
        if self.floating and self.q[0] == self.before[0]:
            found |= kernels.BASE_REPEATS if self.repeats(slice(7), slice(6)) else 0
        return found, x, u

    def repeats(self, q, v):
        same = self.v[v].any() and self.q[q].tobytes() == self.before[q].tobytes()
        return same and self.v[v].tobytes() == self.v_before[v].tobytes()

    def check(self):
        found, mismatch, stuck_motion = self.expect()
        assert self.compare() == found
        np.testing.assert_allclose(self.mismatch, mismatch, rtol=1e-9, atol=1e-11)
        joints = slice(-N, None)  # rounding decides on zeros of the base
        np.testing.assert_allclose(self.stuck_motion[joints], stuck_motion[joints], rtol=1e-9, atol=1e-11)
        return found


@settings(max_examples=400)
@given(
    seed=seeds,
    floating=st.booleans(),
    dt=st.sampled_from([0.0, 0.004, 0.004, kernels.GAP, 0.06, -0.004]),
    joints=st.sampled_from(["move", "move", "some", "still", "repeat", "rest"]),
    base=st.sampled_from(["moves", "moves", "still", "repeats", "rests"]),
    size=st.sampled_from([0.3, 2.0, np.inf]),
    spoilt=st.sampled_from([None] * 6 + ["q", "v"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e3, -1e3]),
)
def test_a_comparison_finds_what_numpy_and_pinocchio_find(seed, floating, dt, joints, base, size, spoilt, value):
    case = Watched(seed, floating=floating)
    case.dt = dt
    case.limits = np.array([[100.0], [size], [size]]) * case.rng.uniform(1.0, 2.0, (3, case.nv))
    if joints in ("still", "repeat", "rest"):
        case.q[-N:] = case.before[-N:]
    elif joints == "some":
        some = case.rng.random(N) < 0.3
        case.q[-N:][some] = case.before[-N:][some]
    if joints == "rest":
        case.v_before[-N:] = 0.0
    if joints in ("repeat", "rest"):
        case.v[-N:] = case.v_before[-N:]
    if floating and base != "moves":
        case.q[:7] = case.before[:7]
    if floating and base == "rests":
        case.v_before[:6] = 0.0
    if floating and base in ("repeats", "rests"):
        case.v[:6] = case.v_before[:6]
    if spoilt:
        getattr(case, spoilt)[case.rng.integers(case.nv)] = value
    case.check()


def test_rest_of_a_robot():
    """Nothing is found, and the mismatch decays."""
    case = Watched(1)
    case.q = case.before.copy()
    for each in (case.v, case.v_before, case.stuck_motion):
        each[:] = 0.0
    case.mismatch[:] = 1e-7
    assert case.check() == 0
    assert (case.mismatch < 1e-7).all()
    assert not case.stuck_motion.any()


def test_a_zero_quaternion_fails():
    for which in ("before", "q"):
        case = Watched(2)
        getattr(case, which)[3:7] = 0.0
        assert np.isnan(case.change()).any()
        assert case.compare() & kernels.JUMPED
