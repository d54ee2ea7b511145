"""Held against the same equations in NumPy, and against Pinocchio."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from wbc_controller.compiled import Bound
from wbc_controller.safety import supervisor_kernels as kernel
from wbc_controller.safety.supervisor_kernels import (
    ABSURD,
    BASE_REPEATS,
    GAP,
    JOINTS_REPEAT,
    JUMPED,
    MEMORY,
    STUCK,
    UNTOLD,
)

N, NV = 12, 18
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("value", [1.0, -1.0, 1.0 + 1e-15, -1.1, np.nan, np.inf, -np.inf])
def test_values_at_their_limits_are_within_and_what_is_not_finite_never_is(value):
    values = np.zeros(N)
    values[7] = value
    assert kernel.within(values, np.ones(N)) == (abs(value) <= 1.0)
    assert kernel.within(values[::-1], np.ones(N)) == (abs(value) <= 1.0)


def supervised(q, v, *, watched=None, dt=math.nan, some_untold=False, axis=None, command=None, following=()):
    """Calls the kernel with some of its parts."""
    parts = watched and watched.table, axis, command and command.table
    tables = Bound(*(0 if part is None else part for part in parts))
    nothing = np.zeros(0)
    tau, v_dot, before, share, kept, step, out = following or (nothing, nothing, nothing, 0.0, 0.0, 0.0, nothing)
    return kernel.supervised(tables.table, q, v, dt, some_untold, tau, v_dot, before, share, kept, step, out)


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
        watched = Bound(
            int(self.floating), len(self.q_index), self.q_index, self.v_index, self.limits, np.array([self.magnitude]),
            *kept, self.mismatch, self.untold,
        )  # fmt: skip
        found, tilted, usable = supervised(self.q, self.v, watched=watched, dt=self.dt, some_untold=self.some_untold)
        assert (tilted, usable) == (0.0, False)
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


@settings(deadline=None, max_examples=300)
@given(
    seed=seeds,
    angle=st.one_of(
        st.floats(0.0, 2.0 * math.pi),
        st.sampled_from([0.0, 1e-16, 1e-12, 1e-9, 1e-8, 3e-8, 1e-6, 1e-4, 1.9e-4, 2e-4, 2.1e-4, 1e-3, 4.9e-3, 0.1]),
        st.sampled_from([1e-12, 1e-9, 1e-6, 1e-3, 0.0]).map(lambda less: math.pi - less),
    ),
    flip=st.booleans(),
    far=st.sampled_from([0.0, 1e-6, 0.01, 1.0, 1e3]),
)
@example(seed=0, angle=1.9e-4, flip=False, far=1e3)
@example(seed=385, angle=4.9e-3, flip=False, far=1e3)
def test_the_change_of_the_base_is_pinocchio_s_difference(seed, angle, flip, far):
    case = Watched(seed)
    axis = case.rng.normal(size=3)
    motion = np.concatenate([far * case.rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    moved = pin.XYZQUATToSE3(case.before[:7]) * pin.SE3(pin.exp3(motion[3:]), motion[:3])
    case.q[:7] = pin.SE3ToXYZQUAT(moved)
    if flip:
        case.q[3:7] *= -1.0
    case.v[:], case.v_before[:], case.mismatch[:], case.magnitude = 0.0, 0.0, 0.0, 1e5
    assert case.compare() != ABSURD
    expected = case.change()
    # Pinocchio's series for turns below 5e-3 rad misses up to 7e-12 of how far the base went; ours is right to 1e-15.
    way, turn = np.linalg.norm(expected[:3]), np.abs(expected[3:])
    close = np.concatenate([np.full(3, 1e-12 + 1e-11 * way), 1e-12 + 1e-9 * turn])
    if not (np.abs(case.mismatch - expected) <= close).all():  # half a turn: the other way round is as good
        assert angle == pytest.approx(math.pi, abs=1e-6)
        np.testing.assert_allclose(case.mismatch[3:6], -expected[3:6], rtol=1e-9, atol=1e-9)


def test_where_a_quaternion_is_zero_the_change_is_not_a_number_and_fails():
    for which in ("before", "q"):
        case = Watched(2)
        getattr(case, which)[3:7] = 0.0
        assert np.isnan(case.change()).any()
        assert case.compare() & JUMPED


@settings(deadline=None)
@given(seed=seeds, spoilt=st.sampled_from([0.0, np.nan]))
def test_the_tilt_is_the_angle_between_the_vertical_before_and_after(seed, spoilt):
    rng = np.random.default_rng(seed)
    before, q = (pin.SE3ToXYZQUAT(pin.exp6(3.0 * rng.normal(size=6))) for _ in range(2))
    vertical = [pin.XYZQUATToSE3(each).rotation[2] for each in (before, q)]
    np.testing.assert_allclose(kernel.upward(before), vertical[0], atol=1e-12)

    def tilt(q):
        found, tilted, usable = supervised(q, np.zeros(6), axis=np.array(kernel.upward(before)))
        assert (found, usable) == (0, False)
        return tilted

    assert math.cos(tilt(q)) == pytest.approx(np.dot(*vertical), abs=1e-12)
    assert tilt(before) == pytest.approx(0.0, abs=1e-6)
    q[4] += spoilt
    assert (tilt(q) <= math.pi) == (spoilt == 0.0)


@settings(deadline=None)
@given(seed=seeds, size=st.sampled_from([0.3, 1.0, 1.01, 1.2]), spoilt=st.sampled_from([0.0, np.nan, np.inf, -np.inf]),
       share=st.sampled_from([0.0, 0.4, 1.0]), kept=st.sampled_from([0.0, 0.7]))  # fmt: skip
def test_the_command_of_a_solution_is_what_numpy_makes_of_it_where_its_torques_are_usable(
    seed, size, spoilt, share, kept
):
    rng = np.random.default_rng(seed)
    limits, rate = rng.uniform(1.0, 20.0, (2, N))
    lower, upper, tau = -limits, 0.9 * limits, rng.uniform(-size, size, N) * limits
    before = rng.uniform(-1.0, 1.0, N) * limits
    tau[rng.integers(N)] += spoilt
    q, v, v_dot = rng.normal(size=NV + 1), rng.normal(size=NV), rng.normal(size=NV)
    v_index = rng.permutation(NV)[:7]
    out = np.empty(N + 14)
    bound = Bound(N, 7, limits, rate, v_index + 1, v_index, np.stack([lower, upper]), np.array([0.05, 0.002]))
    found, tilted, usable = supervised(q, v, command=bound, following=(tau, v_dot, before, share, kept, 0.1, out))
    assert (found, tilted) == (0, 0.0)
    assert usable == ((tau >= lower - 0.05 * limits) & (tau <= upper + 0.05 * limits)).all()
    if usable:
        wanted = kept * before + (1.0 - kept) * (share * tau)
        expected = np.clip(np.clip(wanted, before - 0.1 * rate, before + 0.1 * rate), lower, upper)
        np.testing.assert_allclose(out[:N], expected, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(out[N + 7 :], (v + 0.002 * v_dot)[v_index], rtol=1e-14)
        np.testing.assert_allclose(out[N : N + 7], q[v_index + 1] + 0.002 * out[N + 7 :], rtol=1e-14)


@pytest.mark.parametrize("place", [0, N - 1])
@pytest.mark.parametrize(
    ("tau", "usable"),
    [(1.0, True), (-1.0, True), (1.01, True), (-1.01, True), (1.0101, False), (-1.0101, False), (np.nan, False)],
)
def test_torques_are_usable_up_to_a_solver_s_tolerance_beyond_their_limits(place, tau, usable):
    wanted, ones, nothing = np.zeros(N), np.ones(N), np.zeros(0, dtype=np.int64)
    wanted[place] = tau
    sent = np.empty(N)
    bound = Bound(N, 0, ones, 10.0 * ones, nothing, nothing, np.stack([-ones, ones]), np.array([0.01, 0.1]))
    *_, found = supervised(ones, ones, command=bound, following=(wanted, ones, ones, 1.0, 0.0, 1.0, sent))
    assert found == usable
    assert not usable or abs(sent[place]) == 1.0


@pytest.mark.parametrize("which", ["lower", "upper", "limits"])
def test_where_what_is_available_is_not_a_number_nothing_is_usable(which):
    ones, nothing = np.ones(N), np.zeros(0, dtype=np.int64)
    limits, available = ones.copy(), np.stack([-ones, ones])
    bound = Bound(N, 0, limits, ones, nothing, nothing, available, np.array([0.01, 0.1]))
    following = 0.0 * ones, ones, ones, 1.0, 0.0, 1.0, np.empty(N)
    assert supervised(ones, ones, command=bound, following=following)[2]
    spoilt = limits if which == "limits" else available[int(which == "upper")]
    spoilt[5] = np.nan
    assert not supervised(ones, ones, command=bound, following=following)[2]


@settings(deadline=None)
@given(seed=seeds)
def test_torques_change_by_a_step_and_what_is_available_takes_precedence(seed):
    rng = np.random.default_rng(seed)
    tau, before, limits = 30.0 * rng.normal(size=(3, N))
    tau[2], rate, limits = np.nan, rng.uniform(0.0, 20.0, N), np.abs(limits)
    out, step = np.empty(N), 0.5 * rate
    kernel.limited(tau, before, rate, 0.5, -limits, limits, out)
    np.testing.assert_array_equal(out, np.clip(np.clip(tau, before - step, before + step), -limits, limits))
