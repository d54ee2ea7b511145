"""Kinematic loop."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.contact import Contact
from wbc_controller.inverse_dynamics.contacts.mount import Mount, held_axes, pose_displacement
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


class LoopClosure(Contact):
    """Loop closure that holds a frame B of one link at a frame A of another along some axes of A; always active.

    The pose of B in A is r = R_Aᵀ (p_B - p_A) and Q = R_Aᵀ R_B. With the twist ν of B relative to A in the axes of B,
    and its angular part ω (Q and ω × act on each half of ν),

        γ = [ṙ, R_Aᵀ (ω_B - ω_A)] = Q ν
        γ̇ = Q (ν̇ + ω × ν)

    A spring and damper return to r = 0 and Q = 1 along the held axes (Baumgarte stabilization, 1972):

        γ̇ = -D γ - K e,    e = [r, log Q],    D = 2 √K

    With one free rotation (hinge), the angular part of e is the rotation between the hinge axes. f is the force of A on
    B at the origin of B, in the axes of A.
    """

    permanent = True

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frames: tuple[str, str],
        placements: tuple[pin.SE3, pin.SE3],  # of A and B in these frames
        mask: Sequence[bool] = (True,) * 6,  # held axes of A: along x, y, z, about x, y, z
        *,
        stiffness: float = 400.0,  # K, 1/s²
    ) -> None:
        """Make a loop closure; raises `ConfigurationError` also if no joint is between the frames."""
        self._rows, self._hinge = held_axes(mask, f"loops.{name}.mask")
        basis, cone, damping = np.eye(6)[:, self._rows], np.zeros((0, len(self._rows))), 2.0 * math.sqrt(stiffness)
        super().__init__(name, basis, cone, frames[0], damping=damping, stiffness=stiffness, internal=True)
        self._a = model.frame_id(frames[0], f"loops.{name}.frame_a")
        b = model.frame_id(frames[1], f"loops.{name}.frame_b")
        if model.pinocchio.frames[self._a].parentJoint == model.pinocchio.frames[b].parentJoint:
            raise ConfigurationError(
                f"loops.{name}: no joint is between frame_a = {frames[0]!r} and frame_b = {frames[1]!r}"
            )
        self._placement = placements[0]
        self._mount = Mount(model, name, frames[1], placements[1], frames[0])

    def _pose(self, dynamics: Dynamics) -> pin.SE3:
        return self._placement.actInv(self._mount.pose(dynamics))

    def _along_held_axes(self, dynamics: Dynamics, values: Array) -> Array:
        """Return the held components in the axes of A of values in the axes of B, (k,) or (k, nv)."""
        Q = self._pose(dynamics).rotation
        return np.concatenate([Q @ values[:3], Q @ values[3:]])[self._rows]

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return the Jacobian of γ along the held axes, (k, nv)."""
        return self._along_held_axes(dynamics, self._mount.relative(dynamics, dynamics.jacobian))

    def drift(self, dynamics: Dynamics) -> Array:
        """Return γ̇ at v̇ = 0 along the held axes, (k,)."""
        nu, nu_dot = self._mount.relative(dynamics, dynamics.velocity), self._mount.drift(dynamics)
        nu_dot[:3] += pin.skew(nu[3:]) @ nu[:3]  # ω × ω = 0
        return self._along_held_axes(dynamics, nu_dot)

    def error(self, dynamics: Dynamics) -> Array:
        """Return e along the held axes, (k,) in m and rad."""
        return pose_displacement(self._pose(dynamics), self._hinge)[self._rows]

    def acceleration_at_rest(self, dynamics: Dynamics) -> Array:
        """Return the required J v̇ at J v = 0, (k,): -drift - K e."""
        return np.asarray(super().acceleration_at_rest(dynamics) - self.stiffness * self.error(dynamics))

    def points(self, dynamics: Dynamics) -> Array:
        """Return the origin of A in the world, (1, 3) in m."""
        return np.array((dynamics.placement(self._a) * self._placement).translation)[None, :]

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """Return the wrench on B, (6,)."""
        axes, b = dynamics.placement(self._a) * self._placement, self._mount.placement(dynamics)
        return np.asarray(pin.SE3(axes.rotation, b.translation).act(pin.Force(self.basis @ force)).vector)

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Return infinite bounds, (k,)."""
        return np.full(self.size, -np.inf), np.full(self.size, np.inf)
