"""Constraints: finite differences, forces, stabilization."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from mechanisms import ball, links, move, names, random_case, rate_along, robot, seeds

from wbc_controller import mechanics as wbm


def placed(rng):
    return pin.exp6(rng.normal(size=6))


def every_kind(model, rng):
    first, second = (str(name) for name in rng.choice(links(model), 2, replace=False))
    joints = [model.names[j] for j in range(1, model.njoints) if model.joints[j].nq == 1]
    support = wbm.oscillating_support(0.5 * rng.normal(size=6), 0.4, 3.0)
    a, b, n = rng.normal(size=(3, 3))
    n[2] += 2.0
    return [
        wbm.PointContact(frame=first, offset=a, target=b),
        wbm.PointContact(frame=first, offset=a, target=b, support=support),
        wbm.SurfaceContact(frame=first, placement=placed(rng), target=placed(rng)),
        wbm.SurfaceContact(frame=first, placement=placed(rng), target=placed(rng), support=support),
        wbm.JointCoupling(coefficients={joints[0]: 1.0, joints[-1]: -2.5}, offset=0.3),
        wbm.PinnedFrames(first=first, second=second, first_offset=a, second_offset=b),
        wbm.WeldedFrames(first=first, second=second, first_placement=placed(rng), second_placement=placed(rng)),
        wbm.Rolling(frame=first, radius=0.3, centre=a),
        wbm.Rolling(frame=first, radius=0.3, centre=a, normal=n, height=0.2),
        wbm.Rolling(frame=first, radius=0.3, centre=a, axis=b, normal=n),
        wbm.PlaneContact(frame=first, offset=a, normal=n, height=0.1),
    ]


@settings(max_examples=25)
@given(names, seeds)
def test_rates_are_finite_differences(name, seed):
    """d/dt position = velocity, d/dt velocity = A v̇ + drift, along a motion with any acceleration."""
    model, rng, q, v = random_case(name, seed)
    v_dot, t, eps = rng.normal(size=model.nv), float(rng.uniform(0, 2)), 1e-5
    now, after, before = (
        wbm.Kinematics(model, pin.integrate(model, q, s * v + 0.5 * s * s * v_dot), v + s * v_dot, t + s)
        for s in (0.0, eps, -eps)
    )
    for constraint in every_kind(model, rng):
        terms, ends = constraint.terms(now), (constraint.terms(after), constraint.terms(before))
        rate = (ends[0].velocity - ends[1].velocity) / (2 * eps)
        scale = 1.0 + np.abs(rate).max()
        assert np.abs(rate - terms.jacobian @ v_dot - terms.drift).max() < 1e-5 * scale, constraint
        if isinstance(constraint, wbm.SurfaceContact | wbm.WeldedFrames):
            continue  # position error is a logarithm: its rate is the twist near zero only
        change = (ends[0].position - ends[1].position) / (2 * eps)
        assert np.abs((change - terms.velocity)[terms.holonomic]).max(initial=0.0) < 1e-5 * scale, constraint


@settings(max_examples=10)
@given(names, seeds)
def test_a_welds_error_moves_with_its_twist_near_zero(name, seed):
    model, rng, q, v = random_case(name, seed)
    frame = links(model)[-1]
    near = wbm.Kinematics(model, q, v).placement(frame) * pin.exp6(1e-6 * rng.normal(size=6))
    contact = wbm.SurfaceContact(frame=frame, target=near)

    def terms(q, v):
        return contact.terms(wbm.Kinematics(model, q, v))

    rate, velocity = rate_along(lambda q, v: terms(q, v).position, model, q, v, 0 * v, 1e-5), terms(q, v).velocity
    assert np.allclose(rate, velocity, atol=1e-4 * max(1.0, np.abs(velocity).max()))


@settings(max_examples=15)
@given(names, seeds)
def test_multipliers_are_forces_that_act_on_the_links(name, seed):
    """Aᵀλ equals Jᵀw of the documented wrenches λ (equation (22))."""
    model, rng, q, v = random_case(name, seed)
    kinematics = wbm.Kinematics(model, q, v)
    first, second = (str(name) for name in rng.choice(links(model), 2, replace=False))
    a, b, force = rng.normal(size=(3, 3))
    wrench, zero = rng.normal(size=6), np.zeros(3)

    def force_of(constraint, multipliers):
        return wbm.constraint_equation([constraint], kinematics).A.T @ multipliers

    def at(frame, force, offset):
        arm = kinematics.placement(frame).rotation @ offset
        push = wbm.ExternalWrench(frame, np.concatenate([force, zero]), "LOCAL_WORLD_ALIGNED", arm)
        return wbm.generalized_force(model, q, [push])

    point = force_of(wbm.PointContact(frame=first, offset=a), force)
    assert np.allclose(point, at(first, force, a), atol=1e-9)
    pinned = force_of(wbm.PinnedFrames(first=first, second=second, first_offset=a, second_offset=b), force)
    assert np.allclose(pinned, at(first, force, a) - at(second, force, b), atol=1e-9)
    surface = force_of(wbm.SurfaceContact(frame=first), wrench)
    expected = wbm.generalized_force(model, q, [wbm.ExternalWrench(first, wrench, "LOCAL")])
    assert np.allclose(surface, expected, atol=1e-9)


def test_stabilisation_takes_errors_out_with_the_time_constant():
    """g̈ + (2/T) ġ + g/T² = 0: from g₀ at rest, g = g₀ (1 + t/T) exp(-t/T)."""
    model = robot("panda")
    q = np.full(model.nq, 0.2)
    T, g0 = 0.1, 0.05
    gears, offset = {"panda_joint2": 1.0, "panda_joint4": 2.0}, float(q[1] + 2 * q[3] - g0)
    coupling = wbm.JointCoupling(coefficients=gears, offset=offset, time_constant=T)
    qs, _ = move(model, [coupling], q, np.zeros(model.nv), 2e-3, 200)
    errors = qs[:, 1] + 2 * qs[:, 3] - coupling.offset
    times = 2e-3 * np.arange(201)
    assert np.allclose(errors, g0 * (1 + times / T) * np.exp(-times / T), atol=1e-7)
    # Non-holonomic rows: γ̇ + γ/T = 0. A sliding ball begins to roll.
    model = ball(1.0)
    rolling = wbm.Rolling(frame="ball_link", radius=0.1, height=-0.1, time_constant=T)
    qs, vs = move(model, [rolling], pin.neutral(model), np.eye(6)[0], 2e-3, 200)
    states = zip(qs[::20], vs[::20], strict=True)
    slip = [rolling.terms(wbm.Kinematics(model, *state)).velocity[0] for state in states]
    assert np.allclose(slip, np.exp(-times[::20] / T), atol=1e-7)
    # Friction at the contact reduces the velocity to 5/7.
    assert np.linalg.norm(pin.XYZQUATToSE3(qs[-1]).rotation @ vs[-1][:3]) == pytest.approx(5 / 7, abs=0.01)
