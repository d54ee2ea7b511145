"""Bounded least squares with standard errors, and the tables of `wbc identify`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import lsq_linear
from scipy.stats import norm, t

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.identification.equations import WIDTH, Equations, equations, select_samples
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array
from wbc_controller.settings import Settings

_MASS_BOUNDS = (0.2, 5.0)  # shares of a link's mass
UNSURE = 0.025  # relative standard error of a determined value (95 %: 5 %)
#: Weak prior: standard deviations from the model's values, as shares of masses, kg·m², N·m, N·m·s/rad.
_PRIOR = {"mass": 0.5, "armature": 0.5, "dry": 20.0, "viscous": 20.0}
_TORQUE_ERROR = 0.01  # relative standard error of torque constants and all values


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
