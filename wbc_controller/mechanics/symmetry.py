"""Symmetries of the Lagrangian and the quantities that they conserve (section 3.1, equations (23)–(28); S5)."""

from __future__ import annotations

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

#: A field of perturbations: from q, (nq,), to δq(q), (nv,), in the coordinates of the velocity.
Perturbation = Callable[[Array], Array]

#: Step ε of the central differences, whose error is of the order of ε² plus rounding / ε.
_STEP = 1.0e-5


def lagrangian_variation(model: pin.Model, q: Array, v: Array, perturbation: Perturbation) -> float:
    """First-order change δL of the Lagrangian under q → q ⊕ ε δq(q), per ε, in J: equation (24).

    As in (23), the velocity changes with the configuration. On the configuration manifold this change is the tangent
    map of q → q ⊕ ε δq(q), computed from Pinocchio's two derivatives of ⊕; in plain coordinates it is d(δq)/dt. The
    result is accurate to about 1e-8 of the energies involved.

    Raises:
        InputRefused: if the perturbation has another shape than (nv,), or is not finite.
    """
    data = model.createData()

    def field(at: Array) -> Array:
        return as_array("δq(q)", perturbation(at), (model.nv,))

    delta = field(q)
    forth, back = (field(pin.integrate(model, q, sign * _STEP * v)) for sign in (1.0, -1.0))
    delta_rate = (forth - back) / (2.0 * _STEP)  # d/dt of δq(q) along v
    values = []
    for epsilon in (_STEP, -_STEP):
        by_q, by_delta = pin.dIntegrate(model, q, epsilon * delta)
        moved = pin.integrate(model, q, epsilon * delta)
        values.append(lagrangian(model, moved, by_q @ v + epsilon * (by_delta @ delta_rate), data=data))
    return (values[0] - values[1]) / (2.0 * _STEP)


def conserved_quantity(model: pin.Model, q: Array, v: Array, perturbation: Perturbation) -> float:
    """The quantity pᵀδq(q) of equation (28), N·s or N·m·s, which is conserved without other forces if δL = 0.

    In general d/dt(pᵀδq) = δL + δqᵀf, with f all generalized forces that are not part of the Lagrangian.

    Raises:
        InputRefused: if the perturbation has another shape than (nv,), or is not finite.
    """
    return float(generalized_momentum(model, q, v) @ as_array("δq(q)", perturbation(q), (model.nv,)))


@dataclass(frozen=True, slots=True)
class SymmetryReport:
    """Whether a perturbation is a symmetry (equation (23)), and the quantity that it conserves (equation (28)).

    Attributes:
        variation: largest |δL| over the given states, relative to the size of its terms (gravity and momentum) there.
        conserved: pᵀδq at each of the states, (k,) in N·s or N·m·s.
        invariant: True if the variation is zero to the accuracy of the differences.
    """

    variation: float
    conserved: Array
    invariant: bool


def check_symmetry(
    model: pin.Model, states: list[tuple[Array, Array]], perturbation: Perturbation, *, tolerance: float = 1.0e-6
) -> SymmetryReport:
    """Check whether the Lagrangian is invariant to first order under a perturbation (equations (23) and (27)).

    Args:
        states: pairs of configuration (nq,) and generalized velocity (nv,), in m/s and rad/s, at which to check.
        tolerance: largest relative |δL| that counts as zero.

    Raises:
        InputRefused: if the perturbation has another shape than (nv,), or is not finite.
    """
    worst = 0.0
    for q, v in states:
        delta = as_array("δq(q)", perturbation(q), (model.nv,))
        p = generalized_momentum(model, q, v)
        # δL is a sum of terms of this size, so that a remainder within their rounding errors counts as zero.
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        scale = np.linalg.norm(delta) * (np.linalg.norm(gravity) + np.linalg.norm(p) * (1.0 + np.linalg.norm(v)))
        worst = max(worst, abs(lagrangian_variation(model, q, v, perturbation)) / (float(scale) + 1.0e-12))
    conserved = np.array([conserved_quantity(model, q, v, perturbation) for q, v in states])
    return SymmetryReport(variation=worst, conserved=conserved, invariant=bool(worst <= tolerance))


def _require_free_flyer(model: pin.Model) -> None:
    if model.njoints < 2 or model.joints[1].nq != 7:
        first = model.joints[1].shortname() if model.njoints > 1 else "no joint"
        raise ConfigurationError(f"the model begins with {first}; a floating base (JointModelFreeFlyer) is needed")


def translation(model: pin.Model, direction: npt.ArrayLike) -> Perturbation:
    """Translation of the whole robot, m: the symmetry of (23) that conserves linear momentum along a direction.

    Args:
        direction: in the world, (3,).

    Raises:
        ConfigurationError: if the base is not floating.
        InputRefused: if the direction has another shape, or is not finite.
    """
    _require_free_flyer(model)
    world = as_array("direction", direction, (3,))

    def perturbation(q: Array) -> Array:
        delta = np.zeros(model.nv)
        delta[:3] = pin.XYZQUATToSE3(q[:7]).rotation.T @ world
        return delta

    return perturbation


def rotation(model: pin.Model, axis: npt.ArrayLike, point: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Perturbation:
    """Rotation of the whole robot, rad: the symmetry of (23) that conserves angular momentum about a world axis.

    Args:
        axis: in the world, (3,).
        point: on the axis, in the world, (3,) in m.

    Raises:
        ConfigurationError: if the base is not floating.
        InputRefused: if the axis or the point has another shape, or is not finite.
    """
    _require_free_flyer(model)
    turn, through = as_array("axis", axis, (3,)), as_array("point", point, (3,))

    def perturbation(q: Array) -> Array:
        base = pin.XYZQUATToSE3(q[:7])
        delta = np.zeros(model.nv)
        delta[:3] = base.rotation.T @ np.cross(turn, base.translation - through)
        delta[3:6] = base.rotation.T @ turn
        return delta

    return perturbation


def joint_shift(model: pin.Model, joint: str) -> Perturbation:
    """Shift of one joint, rad or m: a symmetry of (23) if L does not depend on its position (a vertical first axis).

    Args:
        joint: a joint with one degree of freedom; δq, (nv,), is constant.

    Raises:
        ConfigurationError: if the joint is unknown, or has more or less than one degree of freedom.
    """
    delta = np.zeros(model.nv)
    delta[single_joint(model, joint).idx_v] = 1.0
    return lambda q: delta
