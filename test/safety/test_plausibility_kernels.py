"""Comparisons of states: equal to the same equations in NumPy."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.safety.plausibility_kernels import (
    ABSURD,
    BASE_REPEATS,
    GAP,
    JOINTS_REPEAT,
    JUMPED,
    MEMORY,
    STUCK,
    UNTOLD,
    StateMemory,
    compare,
)

N, NV = 12, 18
seeds = st.integers(0, 2**32 - 1)


class Watched:
    """Two states of a free flyer with joints in any order and a follower, and what is remembered."""

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
        self.mismatch, self.untold = rng.normal(size=(2, self.nv))
        self.some_untold = True

    def configuration(self, motion):
        if not self.floating:
            return motion
        turn = pin.SE3ToXYZQUAT(pin.exp6(pin.Motion(motion[:6])))
        return np.concatenate([turn, motion[6:]])

    def change(self):
        """As Pinocchio has it."""
        joints = self.q[-N:] - self.before[-N:]
        if not self.floating:
            return joints
        model = pin.Model()
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        return np.concatenate([pin.difference(model, self.before[:7], self.q[:7]), joints])

    def compare(self):
        kept = [each.copy() for each in (self.before, self.v_before)]
        memory = StateMemory(
            q_index=self.q_index,
            v_index=self.v_index,
            base_q=np.arange(7 if self.floating else 0),
            base_v=np.arange(6 if self.floating else 0),
            magnitude=self.magnitude,
            fastest=self.limits[0],
            tolerance=self.limits[1],
            motionless=self.limits[2],
            before=kept[0],
            v_before=kept[1],
            mismatch=self.mismatch,
            untold=self.untold,
        )
        found = compare(memory, self.q, self.v, self.dt, self.some_untold)
        expected = [self.before, self.v_before] if found & ABSURD else [self.q, self.v]
        assert all(each.tobytes() == other.tobytes() for each, other in zip(kept, expected, strict=True))
        return found

    def expect(self):
        """What NumPy makes of it: what is found, mismatches, and what is untold."""
        fastest, tolerance, motionless = self.limits
        x, u = self.mismatch, self.untold
        if not (np.abs(self.q) <= self.magnitude).all() or not (np.abs(self.v) <= fastest).all():
            return ABSURD, x, u
        moves = self.v.any() or self.v_before.any() or self.some_untold or (x**2).sum() > 1e-12
        if not moves and self.q.tobytes() == self.before.tobytes():
            return 0, x, u
        change, told = self.change(), 0.5 * self.dt * (self.v_before + self.v)
        known, keep = 0.0 <= self.dt <= GAP, 1.0 - self.dt / MEMORY
        reach = abs(self.dt) * fastest
        x = keep * x + (change - told) if known else change - np.clip(change, -reach, reach)
        found = 0
        if not (np.abs(x) <= tolerance).all():
            found, u = found | JUMPED, np.zeros(self.nv)
        if change[self.v_index].all():
            u = np.zeros(self.nv)
        else:
            found |= UNTOLD if known or self.some_untold else 0
            if known:
                u = np.where(change == 0.0, keep * u + told, 0.0)
                found |= 0 if (np.abs(u) <= motionless).all() else STUCK
            found |= JOINTS_REPEAT if self.repeats(self.q_index, self.v_index) else 0
        if self.floating and self.q[0] == self.before[0]:
            found |= BASE_REPEATS if self.repeats(slice(7), slice(6)) else 0
        return found, x, u

    def repeats(self, q, v):
        same = self.v[v].any() and self.q[q].tobytes() == self.before[q].tobytes()
        return same and self.v[v].tobytes() == self.v_before[v].tobytes()

    def check(self):
        found, mismatch, untold = self.expect()
        assert self.compare() == found
        np.testing.assert_allclose(self.mismatch, mismatch, rtol=1e-9, atol=1e-11)
        joints = slice(-N, None)  # where the base's change is zero is a matter of rounding
        np.testing.assert_allclose(self.untold[joints], untold[joints], rtol=1e-9, atol=1e-11)
        return found


BITS = [ABSURD, JUMPED, STUCK, UNTOLD, JOINTS_REPEAT, BASE_REPEATS]


@settings(deadline=None, max_examples=400)
@given(
    seed=seeds,
    floating=st.booleans(),
    dt=st.sampled_from([0.0, 0.004, 0.004, GAP, 0.06, -0.004]),
    joints=st.sampled_from(["move", "move", "some", "still", "repeat", "rest"]),
    base=st.sampled_from(["moves", "moves", "still", "repeats", "rests"]),
    size=st.sampled_from([0.3, 2.0, np.inf]),
    some_untold=st.booleans(),
    spoilt=st.sampled_from([None] * 6 + ["q", "v"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e3, -1e3]),
)
def test_a_comparison_finds_what_numpy_and_pinocchio_find(
    seed, floating, dt, joints, base, size, some_untold, spoilt, value
):
    case = Watched(seed, floating=floating)
    case.dt, case.some_untold = dt, some_untold
    case.limits = np.array([[100.0], [size], [size]]) * case.rng.uniform(1.0, 2.0, (3, case.nv))
    if not some_untold:
        case.untold[:] = 0.0
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


@pytest.mark.parametrize("bit", BITS)
def test_every_finding_occurs_among_such_cases(bit):
    case = Watched(0)
    case.limits[:] = 1e3
    if bit == ABSURD:
        case.v[4] = np.nan
    if bit in (JUMPED, STUCK):
        case.limits[1 if bit == JUMPED else 2] = 1e-6
    if bit in (STUCK, UNTOLD, JOINTS_REPEAT):
        case.q[-N:], case.v[-N:] = case.before[-N:], case.v_before[-N:]
    if bit == BASE_REPEATS:
        case.q[:7], case.v[:6] = case.before[:7], case.v_before[:6]
    assert case.check() & bit


@pytest.mark.parametrize("what", ["nothing", "v", "v_before", "untold", "mismatch", "q", "sign"])
def test_a_robot_rests_where_nothing_moves_and_nothing_is_left_to_be_compared(what):
    case = Watched(1)
    case.before[-1] = 0.0
    case.q = case.before.copy()
    for each in (case.v, case.v_before, case.mismatch, case.untold):
        each[:] = 0.0
    case.mismatch[4], case.some_untold = 1e-7, what == "untold"
    if what in ("v", "v_before", "mismatch"):
        getattr(case, what)[-1] = 1e-5
    if what == "q":
        case.q[-1] = 1e-9
    if what == "sign":
        case.q[-1] = -0.0
    kept = case.mismatch.copy()
    assert (case.check() == 0) == (what == "nothing")
    assert np.array_equal(case.mismatch, kept) == (what == "nothing")


def test_where_a_quaternion_is_zero_the_change_is_not_a_number_and_fails():
    for which in ("before", "q"):
        case = Watched(2)
        getattr(case, which)[3:7] = 0.0
        assert np.isnan(case.change()).any()
        assert case.compare() & JUMPED
