"""Identification of dynamic parameters: `wbc identify`.

The equations of motion are linear in masses, friction and armature:

    M v̇ + h = Sᵀτ + Jᵀf - c sign(v) - b v (S1)

The left side is Y(q, v, v̇) π, linear in the inertial parameters of the links (Atkeson, An, Hollerbach, "Estimation of
inertial parameters of manipulator loads and links", IJRR 1986) and in the armature. With the inertia of each link
proportional to its mass, π = Σ μᵢ πᵢ, the unknowns are

    θ = [μ of each link, armature, c of each joint, b of each joint].

A basis Z of the motions permitted by the contacts, J Z = 0, eliminates the unmeasured contact forces (d'Alembert's
principle, equations (17) to (19); S3), and likewise the undetermined dry friction of resting joints.

The fit is a bounded least squares with standard errors.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from scipy.optimize import lsq_linear
from scipy.stats import norm, t

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array
from wbc_controller.settings import Settings

WIDTH, _INTERVAL = 0.03, 0.02  # of a sample, and time between samples, s
_STRETCH = 25  # samples per group
_REST_SPEED = 0.03  # of a resting joint, rad/s or m/s
_MASS_BOUNDS = (0.2, 5.0)  # shares of a link's mass
UNSURE = 0.025  # relative standard error of a determined value (95 %: 5 %)
#: Weak prior: standard deviations from the model's values, as shares of masses, kg·m², N·m, N·m·s/rad.
_PRIOR = {"mass": 0.5, "armature": 0.5, "dry": 20.0, "viscous": 20.0}
_TORQUE_ERROR = 0.01  # relative standard error of torque constants and all values


@dataclass(frozen=True, slots=True)
class Samples:
    """Smoothed samples of a recording."""

    q: Array  # (n, nq)
    v: Array  # (n, nv)
    v_dot: Array  # (n, nv)
    tau: Array  # (n, na) in N·m
    velocity_signs: Array  # of the joints, (n, nj); 0 at rest or at a reversal
    contacts: tuple[tuple[str, ...], ...]  # active contacts of each sample


@dataclass(frozen=True, slots=True)
class Equations:
    """A θ = b, in N·m and N."""

    A: Array  # (m, k)
    b: Array  # (m,)
    names: tuple[str, ...]  # of the unknowns, (k,): ``mass <link>``, ``armature``, ``dry <joint>``, ``viscous <joint>``
    nominal: Array  # values of the model, (k,); 1 for a mass
    group: np.ndarray  # group of successive samples, with correlated residuals, (m,)


def select_samples(
    recorded: Mapping[str, Array], model: RobotModel, contacts: Mapping[str, Contact], width: float = WIDTH
) -> Samples:
    """Select and smooth samples with an active controller and constant contacts; the window has a `width` in s.

    Raises `ConfigurationError` if the arrays (`Recording.arrays`) are of another robot, or have no such samples.
    """
    missing = [name for name in ("stamp", "mode", "tau", "q", "v") if name not in recorded]
    if missing:
        raise ConfigurationError(f"missing in the recording: {', '.join(missing)}; record with `wbc run --record`")
    for name, size in (("q", model.nq), ("v", model.nv), ("tau", model.na)):
        if recorded[name].ndim != 2 or recorded[name].shape[1] != size:
            raise ConfigurationError(
                f"{name} has {recorded[name].shape[1:]} values per cycle; this robot has {size}: it is another robot"
            )
    time = 1.0e-9 * np.asarray(recorded["stamp"], dtype=np.float64)
    if len(time) < 2:
        raise ConfigurationError(f"the recording has {len(time)} cycles; at least 2 are required")
    gap = float(np.median(np.diff(time)))
    half = max(2, round(0.5 * width / gap))
    forces = {name: recorded[f"force/{name}"] for name in contacts if f"force/{name}" in recorded}
    holds = np.array([np.isfinite(force).all(axis=1) for force in forces.values()]).T.reshape(len(time), len(forces))
    usable = (np.asarray(recorded["mode"]) == "active") & np.isfinite(recorded["q"]).all(axis=1)
    usable &= np.isfinite(recorded["v"]).all(axis=1) & (holds.any(axis=1) if model.floating_base else True)
    steady = np.concatenate([[True], (np.abs(np.diff(time) - gap) < 0.2 * gap) & (holds[1:] == holds[:-1]).all(axis=1)])
    broken = np.concatenate([[0], np.cumsum(~(usable & steady))])
    middle = np.arange(half, len(time) - half, max(1, round(_INTERVAL / gap)))
    middle = middle[broken[middle + half + 1] == broken[middle - half]]
    if not len(middle):
        raise ConfigurationError(
            f"no interval of {width:g} s has regular states, an active controller and constant contacts"
        )
    # The slope of a line through the velocities is a weighted mean of their differences, each caused by the torques of
    # its interval: torques get the same weights.
    weights = np.cumsum(np.arange(-half, half + 1)[::-1])[:-1][::-1].astype(np.float64)
    weights /= weights.sum()
    intervals = middle[:, None] + np.arange(-half, half)
    speeds, tau = np.nan_to_num(recorded["v"]), np.nan_to_num(recorded["tau"])
    v_dot = np.einsum("k,ikj->ij", weights, speeds[intervals + 1] - speeds[intervals]) / gap
    v = 0.5 * np.einsum("k,ikj->ij", weights, speeds[intervals + 1] + speeds[intervals])
    tau = np.einsum("k,ikj->ij", weights, tau[intervals])
    held = tuple(tuple(name for name, on in zip(forces, holds[i], strict=True) if on) for i in middle)
    around = speeds[intervals][:, :, model.v_index]
    forward, backward = around.min(axis=1) > _REST_SPEED, around.max(axis=1) < -_REST_SPEED
    velocity_signs = forward.astype(np.float64) - backward
    return Samples(np.asarray(recorded["q"])[middle], v, v_dot, tau, velocity_signs, held)


def equations(samples: Samples, model: RobotModel, contacts: Mapping[str, Contact]) -> Equations:
    """Return the equations of all samples."""
    robot, actuation = model.pinocchio, model.actuation
    data, dynamics = robot.createData(), Dynamics(model)
    links = [i for i in range(1, robot.njoints) if robot.inertias[i].mass > 0.0]
    shares = np.zeros((10 * (robot.njoints - 1), len(links)))
    for column, i in enumerate(links):
        shares[10 * (i - 1) : 10 * i, column] = robot.inertias[i].toDynamicParameters()
    geared = np.array(robot.armature) > 0.0
    joints = np.zeros((model.nv, model.nj))
    joints[model.v_index, np.arange(model.nj)] = 1.0
    rows, right, group = [], [], []
    for i, (q, v, v_dot, tau, velocity_signs, held) in enumerate(
        zip(samples.q, samples.v, samples.v_dot, samples.tau, samples.velocity_signs, samples.contacts, strict=True)
    ):
        dynamics.update(q, v)
        J = np.vstack([*(contacts[name].jacobian(dynamics) for name in held), joints.T[velocity_signs == 0.0]])
        Z = _null_space(J)
        if not Z.shape[1]:
            continue
        Y = pin.computeJointTorqueRegressor(robot, data, q, v, v_dot)
        moving = v[model.v_index]
        A = np.hstack([Y @ shares, (geared * v_dot)[:, None], joints * velocity_signs, joints * moving])
        known = actuation.generalized_force(tau) + model.passive_force(q, v)
        if actuation.rotors is not None:
            known = known - actuation.rotors @ v_dot
        rows.append(Z.T @ A)
        right.append(Z.T @ known)
        group.append(np.full(Z.shape[1], i // _STRETCH))
    first_links = {f.parentJoint: f.name for f in list(robot.frames)[::-1] if f.type == pin.BODY}  # of each joint
    names = [f"mass {first_links[i]}" for i in links]
    names += ["armature", *(f"{kind} {joint}" for kind in ("dry", "viscous") for joint in model.joints)]
    armature = float(np.max(robot.armature, initial=0.0))
    nominal = np.concatenate([np.ones(len(links)), [armature], np.zeros(2 * model.nj)])
    if not rows:
        raise ConfigurationError("the recording contains no motion that its contacts permit")
    return Equations(np.vstack(rows), np.concatenate(right), tuple(names), nominal, np.concatenate(group))


def _null_space(J: Array) -> Array:
    """Return an orthonormal basis of the velocities v with J v = 0, (nv, n - rank)."""
    _, sizes, V = np.linalg.svd(J)
    rank = int(np.count_nonzero(sizes > 1.0e-9 * max(1.0, float(np.max(sizes, initial=0.0)))))
    return np.asarray(V[rank:].T)


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of the fit."""

    names: tuple[str, ...]  # of the unknowns, as in `Equations`
    values: Array  # (k,)
    errors: Array  # standard errors, (k,)
    residual: float  # root mean square of the equations' residuals, N·m
    count: int  # number of equations

    def determined(self, i: int) -> bool:
        """Return True if the recording determines an unknown."""
        return bool(self.errors[i] < UNSURE * self.values[i])


def fit(system: Equations, narrower: Equations) -> Fit:
    """Solve min ‖A θ - b‖² / σ² + ‖(θ - θ₀) / s‖² with bounds for positive masses and frictions.

    Residuals are correlated and contain model errors. Therefore the standard errors combine

    - the jackknife over groups of successive samples (Efron, "The jackknife, the bootstrap and other resampling plans",
      SIAM 1982) with Student's distribution, at least the error of independent residuals of size σ,
    - the prior,
    - the change of the solution with half the smoothing, for errors of the equations,
    - `_TORQUE_ERROR` of the value.

    σ is estimated from the residuals of `system`; `narrower` are the equations with half the smoothing.
    """
    scale = np.array([_PRIOR[name.partition(" ")[0]] for name in system.names])
    values, sigma = _solve(system, scale)
    A = np.vstack([system.A / sigma, np.diag(1.0 / scale)])
    normal, right = A.T @ A, A.T @ np.concatenate([system.b / sigma, system.nominal / scale])
    inverse, whole = np.linalg.inv(normal), np.linalg.solve(normal, right)
    groups = np.unique(system.group)
    changes = np.empty((len(groups), len(whole)))
    for change, group in zip(changes, groups, strict=True):
        own = system.group == group
        rows = system.A[own] / sigma
        change[:] = np.linalg.solve(normal - rows.T @ rows, right - rows.T @ system.b[own] / sigma) - whole
    count = len(groups)
    spread = (count - 1) / count * (changes**2).sum(axis=0) + (inverse**2 / scale**2).sum(axis=1)
    few = float(t.ppf(0.975, max(count - 1, 1)) / norm.ppf(0.975))
    spread = few**2 * np.maximum(spread, np.diag(inverse)) + (_TORQUE_ERROR * values) ** 2
    spread += (_solve(narrower, scale)[0] - values) ** 2
    return Fit(system.names, values, np.sqrt(spread), sigma, len(system.b))


def _solve(system: Equations, scale: Array) -> tuple[Array, float]:
    """Return θ, (k,), and σ, the residuals' size relative to the prior with standard deviations s."""
    masses = np.array([name.startswith("mass") for name in system.names])
    bounds = np.where(masses, _MASS_BOUNDS[0], 0.0), np.where(masses, _MASS_BOUNDS[1], np.inf)
    sigma, values = 1.0, system.nominal
    R = np.linalg.qr(np.column_stack([system.A, system.b])).R  # fewer rows with the same minimum
    for _ in range(3):
        A = np.vstack([R[:, :-1] / sigma, np.diag(1.0 / scale)])
        values = lsq_linear(A, np.concatenate([R[:, -1] / sigma, system.nominal / scale]), bounds=bounds).x
        sigma = max(float(np.sqrt(np.mean((system.A @ values - system.b) ** 2))), 1.0e-6)
    return values, sigma


def identify(settings: Settings, path: Path) -> tuple[Fit, RobotModel]:
    """Fit masses, armature and frictions to a recording of this robot; raises `ConfigurationError` otherwise."""
    recorded = Recording(path).arrays()
    try:
        return fit_cycles(settings, recorded)
    except ConfigurationError as error:
        raise ConfigurationError(f"recording {path}: {error}") from error


def fit_cycles(settings: Settings, recorded: Mapping[str, Array]) -> tuple[Fit, RobotModel]:
    """Fit to the arrays of a recording; errors as for `select_samples`."""
    model = make_model(settings)
    contacts = make_qp(settings, model).contacts
    wide, narrow = (
        equations(select_samples(recorded, model, contacts, width), model, contacts) for width in (WIDTH, 0.5 * WIDTH)
    )
    return fit(wide, narrow), model


def report(found: Fit, model: RobotModel) -> str:
    """Return tables of the values with standard errors, and the friction settings."""
    masses, others = [], []
    known: dict[str, dict[str, float]] = {}
    for i, name in enumerate(found.names):
        kind, _, which = name.partition(" ")
        value, error = float(found.values[i]), float(found.errors[i])
        sure = "" if found.determined(i) else "not determined"
        if kind == "mass":
            masses.append((which, f"{100.0 * value:.1f} %", f"{100.0 * error:.1f} %", sure))
        elif kind == "armature":
            others.append(("armature", f"{value:.4f} kg·m²", f"{error:.4f}", sure))
        else:
            unit = "N·m" if kind == "dry" else "N·m·s/rad"
            others.append((f"{which} {kind}", f"{value:.3f} {unit}", f"{error:.3f}", sure))
            if not sure and value > 2.0 * error:
                known.setdefault(which, {})[kind] = round(value, 3)
    nominal = [inertia.mass for inertia in list(model.pinocchio.inertias)[1:] if inertia.mass > 0.0]
    total = sum(mass * share for mass, share in zip(nominal, found.values[: len(masses)], strict=True))
    heading = (
        f"{found.count} equations with residuals of {found.residual:.3g} N·m (RMS); total mass {total:.2f} kg, "
        f"{model.mass:.2f} kg in the URDF. 'not determined': standard error above {100.0 * UNSURE:g} % of the value"
    )
    tables = (
        Table(("link mass (with fixed links), relative to the URDF", "estimate", "± (1 σ)", ""), tuple(masses)),
        Table(("joint", "estimate", "± (1 σ)", ""), tuple(others)),
    )
    text = as_text(heading, tables)
    if known:
        text += "\n" + yaml.safe_dump({"robot": {"friction": known}}, sort_keys=False)
    return text
