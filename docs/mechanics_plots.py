"""Plots of docs/mechanics.md in docs/images.

Requires Matplotlib::

    pip install matplotlib
    python docs/mechanics_plots.py
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pinocchio as pin

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test" / "support"), str(ROOT / "test" / "mechanics")]

mpl.use("svg")
# Reproducible files; text as text for small files.
mpl.rcParams.update(
    {
        "svg.hashsalt": "mechanics",
        "svg.fonttype": "none",
        "font.family": "sans-serif",
        "font.size": 9,
        "figure.figsize": (6.4, 2.6),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "path.simplify_threshold": 0.5,
        "savefig.facecolor": "white",
    }
)

import matplotlib.pyplot as plt  # noqa: E402
from mechanisms import WHEEL_RADIUS, box, four_bar, move  # noqa: E402
from test_motions import drifts, rolling_start, tumbling  # noqa: E402
from test_particles import double_pendulum, positions  # noqa: E402

from wbc_controller import mechanics as wbm  # noqa: E402


def save(figure: plt.Figure, name: str) -> None:
    """Write a picture."""
    figure.tight_layout()
    path = ROOT / "docs" / "images" / f"mechanics-{name}.svg"
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


def action() -> None:
    """Equation (10): action of a pendulum along varied paths."""
    pendulum = pin.Model()
    joint = pendulum.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "swing")
    bob = pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3)))
    pendulum.appendBodyToJoint(joint, bob, pin.SE3.Identity())
    step, zero = 2e-3, np.zeros(1)
    path, _ = wbm.simulate(
        pendulum, lambda q, v, t: wbm.forward_dynamics(pendulum, q, v, zero), np.array([1.0]), zero, step, 250
    )
    bend = np.sin(np.linspace(0.0, np.pi, 251))

    def value(angles: np.ndarray) -> float:
        middle, rate = 0.5 * (angles[1:] + angles[:-1]), np.diff(angles) / step
        return step * sum(
            wbm.lagrangian(pendulum, np.array([a]), np.array([r])) for a, r in zip(middle, rate, strict=True)
        )

    figure, (left, right) = plt.subplots(1, 2)
    times = step * np.arange(251)
    for epsilon in (-0.2, -0.1, 0.1, 0.2):
        left.plot(times, path[:, 0] + epsilon * bend, "0.7", lw=1)
    left.plot(times, path[:, 0], "C0")
    left.set(xlabel="t (s)", ylabel="angle (rad)", title="motion and varied paths")
    epsilons = np.linspace(-0.2, 0.2, 21)
    right.plot(epsilons, [value(path[:, 0] + e * bend) for e in epsilons], "C0.-")
    right.set(xlabel="ε", ylabel="action (J s)", title="stationary at the motion")
    save(figure, "action")


def momentum_and_energy() -> None:
    """Equations (28) and (29): humanoid in free flight."""
    model, q, v = tumbling("g1")
    zero, data = np.zeros(model.nv), model.createData()
    qs, vs = wbm.simulate(model, lambda q, v, t: wbm.forward_dynamics(model, q, v, zero, data=data), q, v, 2e-3, 1500)
    times = 2e-3 * np.arange(0, 1501, 15)
    momenta = np.array([wbm.centroidal_momentum(model, a, b) for a, b in zip(qs[::15], vs[::15], strict=True)])
    figure, axes = plt.subplots(1, 2)
    for axis, rows, title in ((axes[0], slice(0, 3), "linear (N s)"), (axes[1], slice(3, 6), "angular (N m s)")):
        for line, name in zip(momenta[:, rows].T, "xyz", strict=True):
            axis.plot(times, line, label=name)
        axis.set(xlabel="t (s)", title=title)
        axis.legend()
    save(figure, "momentum")

    figure, (left, right) = plt.subplots(1, 2)
    states = list(zip(qs[::15], vs[::15], strict=True))
    left.plot(times, [wbm.kinetic_energy(model, *s) for s in states], label="T")
    left.plot(times, [wbm.potential_energy(model, s[0]) for s in states], label="V")
    left.plot(times, [wbm.hamiltonian(model, *s) for s in states], "k", label="H")
    left.set(xlabel="t (s)", ylabel="J", title="energies")
    left.legend()
    steps = np.array([16e-3, 8e-3, 4e-3, 2e-3, 1e-3])
    errors = np.array([drifts(model, q, v, step, 0.8) for step in steps])
    for line, name in zip(errors.T, ("energy", "linear", "angular"), strict=True):
        right.loglog(steps, line, ".-", label=name)
    right.loglog(steps, errors[0].max() * (steps / steps[0]) ** 4, "k:", label="step⁴")
    right.set(xlabel="step (s)", title="relative drift after 0.8 s")
    right.legend()
    save(figure, "energy")


def rolling() -> None:
    """Equation (30): rolling."""
    model, constraints, q, v = rolling_start()
    qs, vs = move(model, constraints, q, v, 5e-3, 6000)
    some = slice(None, None, 40)
    slip = [
        np.abs(constraints[0].terms(wbm.Kinematics(model, a, b)).velocity).max()
        for a, b in zip(qs[some], vs[some], strict=True)
    ]
    figure, (left, right) = plt.subplots(1, 2)
    left.plot(qs[::10, 0], qs[::10, 1])
    left.set(xlabel="x (m)", ylabel="y (m)", title=f"path of a wheel of {WHEEL_RADIUS} m", aspect="equal")
    right.semilogy(5e-3 * np.arange(len(qs))[some], np.maximum(slip, 1e-18))
    right.set(xlabel="t (s)", ylabel="m/s", title="velocity of the contact point")
    save(figure, "rolling")


def closed_loop() -> None:
    """Equation (30): closed loop."""
    model, loop, q, v = four_bar()
    qs, vs = move(model, loop, q, v, 5e-3, 6000)
    figure, (left, right) = plt.subplots(1, 2)
    times = 5e-3 * np.arange(len(qs))
    first = times <= 4.0
    for line, name in zip((qs[first] - qs[0]).T, ("crank", "coupler", "rocker"), strict=True):
        left.plot(times[first][::4], line[::4], label=name)
    left.set(xlabel="t (s)", ylabel="rad", title="joints")
    left.legend()
    some = slice(None, None, 40)
    gap = [
        np.linalg.norm(loop[0].terms(wbm.Kinematics(model, a, b)).position)
        for a, b in zip(qs[some], vs[some], strict=True)
    ]
    right.semilogy(times[some], np.maximum(gap, 1e-18))
    right.set(xlabel="t (s)", ylabel="m", title="position error of the loop")
    save(figure, "four-bar")


def tipping_box() -> None:
    """Equation (31) with inequalities: box."""
    model, corners = box()
    moments = np.linspace(0.0, 25.0, 51)
    answers = [
        wbm.constrained_dynamics(
            model, pin.neutral(model), np.zeros(6), np.array([0, 0, 0, moment, 0, 0]), unilateral=corners
        )
        for moment in moments
    ]
    figure, (left, right) = plt.subplots(1, 2)
    left.plot(moments, [a.push[[0, 2]].sum() for a in answers], label="lifting side")
    left.plot(moments, [a.push[[1, 3]].sum() for a in answers], label="other side")
    left.set(xlabel="moment (N m)", ylabel="N", title="forces of the floor")
    left.legend()
    right.plot(moments, [a.v_dot[3] for a in answers], "C3")
    right.set(xlabel="moment (N m)", ylabel="rad/s²", title="angular acceleration")
    save(figure, "box")


def particles() -> None:
    """Equation (33): double pendulum as particles and in joint angles."""
    system, model = double_pendulum()
    q, v, zero = np.array([0.9, -0.4]), np.array([0.3, 1.0]), np.zeros(2)
    step, steps = 2.5e-3, 1200
    qs, vs = wbm.simulate(model, lambda q, v, t: wbm.forward_dynamics(model, q, v, zero), q, v, step, steps)
    joints = np.array([positions(model, a, b)[0] for a, b in zip(qs, vs, strict=True)])
    x, x_dot, _, _ = positions(model, q, v)
    nothing = (np.zeros((0, 6)), np.zeros(0))

    def rates(state: np.ndarray) -> np.ndarray:
        rods = wbm.rod_constraints(system, state[0], state[1], time_constant=0.1)
        return np.array([state[1], wbm.solve_in_two_stages(system, rods, nothing).v_dot.reshape(2, 3)])

    state, track = np.array([x, x_dot]), [x]
    for _ in range(steps):
        k1 = rates(state)
        k2 = rates(state + 0.5 * step * k1)
        k3 = rates(state + 0.5 * step * k2)
        state = state + step / 6.0 * (k1 + 2 * k2 + 2 * k3 + rates(state + step * k3))
        track.append(state[0])
    figure, (left, right) = plt.subplots(1, 2)
    both = np.array(track)
    left.plot(joints[::6, 1, 0], joints[::6, 1, 2], label="joint angles")
    left.plot(both[::60, 1, 0], both[::60, 1, 2], "k.", ms=3, label="particles")
    left.set(xlabel="x (m)", ylabel="z (m)", title="the outer bob", aspect="equal")
    left.legend()
    difference = np.linalg.norm(both - joints, axis=2).max(axis=1)
    right.semilogy(step * np.arange(steps + 1)[::10], np.maximum(difference[::10], 1e-18))
    right.set(xlabel="t (s)", ylabel="m", title="difference")
    save(figure, "particles")


if __name__ == "__main__":
    for draw in (action, momentum_and_energy, rolling, closed_loop, tipping_box, particles):
        draw()
