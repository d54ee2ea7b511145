"""Symmetries and conserved quantities (section 3.1, equations (23)–(28); S5)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array, single_joint
from wbc_controller.mechanics.energy import lagrangian
from wbc_controller.mechanics.momentum import generalized_momentum
from wbc_controller.records import Array

Perturbation = Callable[[Array], Array]  # perturbation δq(q), (nv,), in velocity coordinates

_STEP = 1.0e-5  # step ε of central differences


def lagrangian_variation(model: pin.Model, q: Array, v: Array, perturbation: Perturbation) -> float:
    """Return the first-order change δL under q → q ⊕ ε δq(q), per ε, in J, of equations (23) and (24).

    The velocity changes by the tangent map, from Pinocchio's derivatives of ⊕. Accurate to about 1e-8 of the energies.

    Raises:
        InputRefused: if the perturbation is invalid.
    """
    data = model.createData()
    states = (q, *(pin.integrate(model, q, step * v) for step in (_STEP, -_STEP)))
    delta, forth, back = (as_array("δq(q)", perturbation(at), (model.nv,)) for at in states)
    delta_rate = (forth - back) / (2.0 * _STEP)  # d/dt δq(q)
    values = []
    for epsilon in (_STEP, -_STEP):
        by_q, by_delta = pin.dIntegrate(model, q, epsilon * delta)
        moved = pin.integrate(model, q, epsilon * delta)
        values.append(lagrangian(model, moved, by_q @ v + epsilon * (by_delta @ delta_rate), data=data))
    return (values[0] - values[1]) / (2.0 * _STEP)


def conserved_quantity(model: pin.Model, q: Array, v: Array, perturbation: Perturbation) -> float:
    """Return pᵀδq(q) of equation (28), N·s or N·m·s: d/dt(pᵀδq) = δL + δqᵀf with other generalized forces f.

    Raises:
        InputRefused: if the perturbation is invalid.
    """
    return float(generalized_momentum(model, q, v) @ as_array("δq(q)", perturbation(q), (model.nv,)))


@dataclass(frozen=True, slots=True)
class SymmetryReport:
    """Symmetry check of a perturbation (equations (23) and (28))."""

    variation: float  # largest |δL| relative to its terms
    invariant: bool  # True if the variation is within the tolerance


def check_symmetry(
    model: pin.Model, states: list[tuple[Array, Array]], perturbation: Perturbation, *, tolerance: float = 1.0e-6
) -> SymmetryReport:
    """Check if a perturbation leaves the Lagrangian invariant to first order (equations (23) and (27)).

    Args:
        states: pairs of q (nq,) and v (nv,), in m/s and rad/s.
        tolerance: largest relative |δL|.

    Raises:
        InputRefused: if the perturbation is invalid.
    """
    worst = 0.0
    for q, v in states:
        delta = as_array("δq(q)", perturbation(q), (model.nv,))
        p = generalized_momentum(model, q, v)
        # Size of the terms of δL.
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        scale = np.linalg.norm(delta) * (np.linalg.norm(gravity) + np.linalg.norm(p) * (1.0 + np.linalg.norm(v)))
        worst = max(worst, abs(lagrangian_variation(model, q, v, perturbation)) / (float(scale) + 1.0e-12))
    return SymmetryReport(variation=worst, invariant=bool(worst <= tolerance))


def _rigid_motion(model: pin.Model, linear: Array, angular: Array) -> Perturbation:
    """Return the motion of the robot by a twist at the world's origin, in m and rad."""
    if model.njoints < 2 or model.joints[1].nq != 7:
        first = model.joints[1].shortname() if model.njoints > 1 else "no joint"
        raise ConfigurationError(f"the first joint is {first}, expected a floating base (JointModelFreeFlyer)")
    twist = pin.Motion(linear, angular)
    return lambda q: np.append(pin.XYZQUATToSE3(q[:7]).actInv(twist).vector, np.zeros(model.nv - 6))


def translation(model: pin.Model, direction: npt.ArrayLike) -> Perturbation:
    """Return the translation of the robot, m: the symmetry of (23) that conserves linear momentum.

    Args:
        direction: vector in the world, (3,).

    Raises:
        ConfigurationError: if the base is not floating.
        InputRefused: if the direction is invalid.
    """
    return _rigid_motion(model, as_array("direction", direction, (3,)), np.zeros(3))


def rotation(model: pin.Model, axis: npt.ArrayLike, point: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Perturbation:
    """Return the rotation of the robot, rad: the symmetry of (23) that conserves angular momentum.

    Args:
        axis: vector in the world, (3,).
        point: point on the axis in the world, (3,) in m.

    Raises:
        ConfigurationError: if the base is not floating.
        InputRefused: if an array is invalid.
    """
    turn = as_array("axis", axis, (3,))
    return _rigid_motion(model, np.cross(as_array("point", point, (3,)), turn), turn)


def joint_shift(model: pin.Model, joint: str) -> Perturbation:
    """Return the shift of one joint, (nv,) in rad or m: a symmetry of (23) if L does not depend on its position.

    Raises:
        ConfigurationError: if the joint is unknown, or does not have one degree of freedom.
    """
    delta = np.zeros(model.nv)
    delta[single_joint(model, joint).idx_v] = 1.0
    return lambda q: delta
