"""A flat rectangle in contact: six forces."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin

from wbc_controller.core.contacts.contact import Contact
from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.records import Array


def wrench_cone(friction: float, half_length: float, half_width: float) -> Array:
    """Exact cone of the wrenches that a rectangle can bear, by friction pyramids at its corners.

    From Caron, Pham, Nakamura, "Stability of surface contacts for humanoid robots: closed-form formulae of the contact
    wrench cone for rectangular support areas" (ICRA 2015).

    Args:
        friction: half-width of the friction pyramid: |fx| ≤ friction fz and |fy| ≤ friction fz.
        half_length: half of the side along x, m.
        half_width: half of the side along y, m.

    Returns:
        C, (16, 6), so that a wrench w = [fx, fy, fz, τx, τy, τz] about the rectangle's centre can be borne where
        C w ≤ 0 (which implies fz ≥ 0).
    """
    mu, x, y = friction, half_length, half_width
    rows = []
    for sign in (1.0, -1.0):
        rows.append([sign, 0, -mu, 0, 0, 0])  # sliding along x
        rows.append([0, sign, -mu, 0, 0, 0])  # sliding along y
        rows.append([0, 0, -y, sign, 0, 0])  # centre of pressure along y
        rows.append([0, 0, -x, 0, sign, 0])  # centre of pressure along x
    # Yaw: τz ≥ -μ(X+Y)fz + |Y fx - μ τx| + |X fy - μ τy|, and τz ≤ μ(X+Y)fz - |Y fx + μ τx| - |X fy + μ τy|.
    for a, b in itertools.product((1.0, -1.0), repeat=2):
        rows.append([a * y, b * x, -mu * (x + y), -a * mu, -b * mu, -1.0])
        rows.append([a * y, b * x, -mu * (x + y), a * mu, b * mu, 1.0])
    return np.array(rows, dtype=np.float64)


class SurfaceContact(Contact):
    """A rectangle that neither moves nor turns; the wrench [f, τ] is in the contact frame, z the normal."""

    size = 6

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        placement: pin.SE3,
        half_length: float,
        half_width: float,
        *,
        friction: float = 0.7,
        min_normal_force: float = 0.0,
        max_normal_force: float = 1000.0,
        damping: float = 20.0,
    ) -> None:
        """Make a surface contact.

        Args:
            name: the contact's name.
            model: the robot's model.
            frame: a frame of the URDF, fixed to the link that touches.
            placement: of the contact in that frame.
            half_length: half of the rectangle's side along x, m.
            half_width: half of the rectangle's side along y, m.
            friction: Coulomb friction coefficient; the pyramid within the cone is what the wrench is held in.
            min_normal_force: smallest normal force, N.
            max_normal_force: largest normal force, N.
            damping: D, 1/s.

        Raises:
            ConfigurationError: where the model has no such frame.
        """
        cone = wrench_cone(friction / math.sqrt(2.0), half_length, half_width)
        super().__init__(
            name,
            cone,
            friction=friction,
            min_normal_force=min_normal_force,
            max_normal_force=max_normal_force,
            damping=damping,
        )
        self._frame_id = model.frame_id(frame, f"contacts.{name}.frame")
        self._placement = placement
        # (6, 6): twist in the frame to twist in the contact
        self._to_contact: Array = placement.inverse().toActionMatrix()
        self._corners = np.array(
            [[sx * half_length, sy * half_width, 0.0] for sx, sy in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        )

    def placement(self, dynamics: Dynamics) -> pin.SE3:
        """Placement of the contact frame in the world."""
        return dynamics.placement(self._frame_id) * self._placement

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the contact frame in its own axes, (6, nv)."""
        return np.asarray(self._to_contact @ dynamics.jacobian(self._frame_id, pin.LOCAL))

    def drift(self, dynamics: Dynamics) -> Array:
        """Spatial acceleration of the contact frame at v̇ = 0, in its own axes, (6,)."""
        return np.asarray(self._to_contact @ dynamics.drift_local(self._frame_id))

    def points(self, dynamics: Dynamics) -> Array:
        """The rectangle's corners in the world, (4, 3) in m."""
        placement = self.placement(dynamics)
        return np.asarray(self._corners @ placement.rotation.T + placement.translation)

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The wrench, moved from the contact frame to the world's origin, (6,) in N and N·m."""
        return np.asarray(self.placement(dynamics).act(pin.Force(force)).vector)
