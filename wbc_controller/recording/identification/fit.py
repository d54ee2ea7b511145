"""Least squares within physical bounds, with standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import norm, t

from wbc_controller.recording.identification.equations import Equations
from wbc_controller.records import Array

#: Least and largest share of a link's mass.
_SHARES = (0.2, 5.0)
#: Standard error above which a recording does not tell a value, as a share of it: twice that is 5 %.
UNSURE = 0.025
#: Standard deviations of the unknowns from the model's values before the measurement: shares of masses,
#: kg·m², N·m, N·m·s/rad. So weak that only what the recording does not show stays at the model's.
_PRIOR = {"mass": 0.5, "armature": 0.5, "dry": 20.0, "viscous": 20.0}
#: Standard error of the torques, and so of all values, as a share.
_TRUST = 0.01


@dataclass(frozen=True, slots=True)
class Fit:
    """The values found."""

    names: tuple[str, ...]  # of the unknowns, as in `Equations`
    values: Array  # (k,)
    errors: Array  # standard error of each, (k,)
    residual: float  # root mean square of what the equations miss, N·m
    count: int  # number of equations

    def determined(self, i: int) -> bool:
        """Return True if the recording determines an unknown."""
        return bool(self.errors[i] < UNSURE * self.values[i])


def fit(system: Equations, narrower: Equations | None = None) -> Fit:
    """Solve min ‖A θ - b‖² / σ² + ‖(θ - θ₀) / s‖² within bounds: masses stay positive, and frictions damp.

    Neighbouring moments miss alike, and a model error is not noise. So the standard errors combine

    - the jackknife: the spread of the solutions without one stretch of time each (Efron, "The jackknife, the bootstrap
      and other resampling plans", SIAM 1982), with Student's distribution as there are few stretches, but no less than
      independent errors of size σ cause,
    - the prior's share,
    - the change of the solution with half the smoothing, which shows errors of the equations,
    - `_TRUST` of the value, as no torque constant is known better.

    Args:
        system: the equations; σ is found from what they miss.
        narrower: the same equations with half the smoothing; None to leave out the third part.
    """
    scale = np.array([_PRIOR[name.partition(" ")[0]] for name in system.names])
    values, sigma = _solved(system, scale)
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
    spread = few**2 * np.maximum(spread, np.diag(inverse)) + (_TRUST * values) ** 2
    if narrower is not None:
        spread += (_solved(narrower, scale)[0] - values) ** 2
    return Fit(system.names, values, np.sqrt(spread), sigma, len(system.b))


def _solved(system: Equations, scale: Array) -> tuple[Array, float]:
    """Return θ, (k,), and σ: the weight of the prior, with standard deviations s, follows from what is missed."""
    masses = np.array([name.startswith("mass") for name in system.names])
    bounds = np.where(masses, _SHARES[0], 0.0), np.where(masses, _SHARES[1], np.inf)
    sigma, values = 1.0, system.nominal
    R = np.linalg.qr(np.column_stack([system.A, system.b])).R  # fewer rows with the same minimum
    for _ in range(3):
        A = np.vstack([R[:, :-1] / sigma, np.diag(1.0 / scale)])
        values = lsq_linear(A, np.concatenate([R[:, -1] / sigma, system.nominal / scale]), bounds=bounds).x
        sigma = max(float(np.sqrt(np.mean((system.A @ values - system.b) ** 2))), 1.0e-6)
    return values, sigma
