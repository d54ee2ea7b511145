"""Conserved quantities over long motions: free flight, closed loop, rolling."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import FLOATING, WHEEL_RADIUS, four_bar, move, robot, wheel_with_pendulum

from wbc_controller import mechanics as wbm


def tumbling(name):
    """Robot in free flight with free joints."""
    model, rng = robot(name), np.random.default_rng(1)
    q = pin.neutral(model)
    q[3:7] = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
    v = np.concatenate([rng.normal(size=3), 2.0 * rng.normal(size=3), 0.5 * rng.normal(size=model.nv - 6)])
    return model, q, v


def free_flight(model, q, v, step, duration):
    zero, data = np.zeros(model.nv), model.createData()
    qs, vs = wbm.simulate(
        model, lambda q, v, t: wbm.forward_dynamics(model, q, v, zero, data=data), q, v, step, round(duration / step)
    )
    return qs[-1], vs[-1]


def drifts(model, q, v, step, duration):
    """Relative drift of energy and momenta, without the effect of gravity."""
    q1, v1 = free_flight(model, q, v, step, duration)
    before, after = wbm.centroidal_momentum(model, q, v), wbm.centroidal_momentum(model, q1, v1)
    fall = pin.computeTotalMass(model) * np.array(model.gravity.linear) * duration
    return np.array(
        [
            abs(wbm.hamiltonian(model, q1, v1) - wbm.hamiltonian(model, q, v)) / wbm.kinetic_energy(model, q, v),
            np.linalg.norm(after[:3] - fall - before[:3]) / np.linalg.norm(before[:3]),
            np.linalg.norm(after[3:] - before[3:]) / np.linalg.norm(before[3:]),
        ]
    )


@pytest.mark.parametrize("name", FLOATING)
def test_the_drift_falls_at_the_order_of_the_integrator(name):
    model, q, v = tumbling(name)
    coarse, fine = drifts(model, q, v, 8e-3, 0.4), drifts(model, q, v, 4e-3, 0.4)
    order = np.log2(coarse / fine)
    assert (order > 3.5).all(), (coarse, fine, order)
    # Also compare the motion.
    ends = [free_flight(model, q, v, step, 0.4) for step in (8e-3, 4e-3, 2e-3)]
    q, v = ends.pop()
    errors = [np.linalg.norm(pin.difference(model, end, q)) + np.linalg.norm(speed - v) for end, speed in ends]
    assert np.log2(errors[0] / errors[1]) > 3.5, errors


def follow(model, constraints, q, v):
    """Follow a motion for two seconds: it keeps its constraints and its energy, relative to the kinetic one."""
    qs, vs = move(model, constraints, q, v, 5e-3, 400)
    sampled = list(zip(qs[::10], vs[::10], strict=True))
    errors = [wbm.constraint_equation(constraints, wbm.Kinematics(model, *state)) for state in sampled]
    energies = [wbm.hamiltonian(model, *state) for state in sampled]
    assert max(np.abs(e.position).max() for e in errors) < 1e-6
    assert max(np.abs(e.velocity).max() for e in errors) < 1e-6
    assert (max(energies) - min(energies)) / max(wbm.kinetic_energy(model, *state) for state in sampled) < 1e-6
    return qs


def test_a_four_bar_stays_closed_for_two_seconds():
    qs = follow(*four_bar())
    assert qs[-1, 0] > 2.0 * np.pi  # a turn


def rolling_start():
    model, rolling = wheel_with_pendulum()
    q, v, lean = pin.neutral(model), np.zeros(model.nv), 0.03
    q[3:7] = pin.Quaternion(pin.exp3(np.array([lean, 0.0, 0.0]))).coeffs()
    q[2], q[7] = WHEEL_RADIUS * np.cos(lean), 0.5
    v[4:] = [6.0, 0.15, -6.0]
    A = wbm.constraint_equation(rolling, wbm.Kinematics(model, q, v)).A
    v[:3] = -np.linalg.solve(A[:, :3], A @ v)
    return model, rolling, q, v


def test_a_pendulum_on_a_rolling_wheel_rolls_for_two_seconds():
    qs = follow(*rolling_start())
    # The wheel moves along a curve without slip.
    assert np.linalg.norm(qs[-1, :2]) > 0.5
    assert np.abs(qs[:, 1]).max() > 0.02


def test_rolling_leaves_every_place_and_heading_open():
    """Non-holonomic: three rows, but only the height is a function of q."""
    model, rolling, q, v = rolling_start()
    terms = rolling[0].terms(wbm.Kinematics(model, q, v))
    assert terms.holonomic.tolist() == [False, False, True]
    moved = q.copy()
    moved[:2] += [3.0, -7.0]
    assert np.allclose(rolling[0].terms(wbm.Kinematics(model, moved, v)).position, 0.0, atol=1e-12)
