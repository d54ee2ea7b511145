"""Least squares within physical bounds, with standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from wbc_controller.recording.identification.equations import Equations
from wbc_controller.records import Array

#: Least and largest share of a link's mass.
_SHARES = (0.2, 5.0)
#: Standard error above which a recording does not tell a value, as a share of it: twice that is 5 %.
UNSURE = 0.025
#: Standard deviations of the unknowns from the model's values before the measurement: shares of masses,
#: kg·m², N·m, N·m·s/rad. So weak that only what the recording does not show stays at the model's.
_PRIOR = {"mass": 0.5, "armature": 0.5, "dry": 20.0, "viscous": 20.0}


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


def fit(system: Equations) -> Fit:
    """Solve min ‖A θ - b‖² / σ² + ‖(θ - θ₀) / s‖² within bounds: masses stay positive, and frictions damp.

    Args:
        system: the equations; σ is found from what they miss.
    """
    scale = np.array([_PRIOR[name.partition(" ")[0]] for name in system.names])
    lower = np.array([_SHARES[0] if name.startswith("mass") else 0.0 for name in system.names])
    upper = np.array([_SHARES[1] if name.startswith("mass") else np.inf for name in system.names])
    sigma, values = 1.0, system.nominal
    for _ in range(3):  # the weight of the prior follows from what the equations miss
        A = np.vstack([system.A / sigma, np.diag(1.0 / scale)])
        b = np.concatenate([system.b / sigma, system.nominal / scale])
        values = lsq_linear(A, b, bounds=(lower, upper)).x
        missed = system.A @ values - system.b
        sigma = max(float(np.sqrt(np.mean(missed**2))), 1.0e-6)
    A = np.vstack([system.A / sigma, np.diag(1.0 / scale)])
    inverse = np.linalg.inv(A.T @ A)
    # What is missed is alike in neighbouring moments: the errors go by its sums over stretches (Liang, Zeger,
    # "Longitudinal data analysis using generalized linear models", Biometrika 1986), and by the prior.
    missed = (system.A @ values - system.b)[:, None] * system.A / sigma**2
    sums = np.array([missed[system.group == group].sum(axis=0) for group in np.unique(system.group)])
    spread = inverse @ (sums.T @ sums + np.diag(1.0 / scale**2)) @ inverse
    errors = np.sqrt(np.maximum(np.diag(spread), np.diag(inverse)))
    return Fit(system.names, values, errors, sigma, len(system.b))
