"""Kernel for the reference of a swing foot."""

from __future__ import annotations

import numpy as np

from wbc_controller.compilation import OutVector, StridedMatrix, Vector, compiled
from wbc_controller.inverse_dynamics.robot.placement_kernels import place, put, quaternion, subtract, three


@compiled
def frame_in_swing(rotation: StridedMatrix, axes: Vector, mount: Vector, out: OutVector) -> None:
    """Write the reference of a frame for a sole in the air: position, quaternion, velocity and acceleration, (19,).

    The sole turns with its heading ψ about the vertical. With the offset r from its centre to the frame,
    ṗ = ċ + ψ̇ e_z × r and p̈ = c̈ + ψ̈ e_z × r + ψ̇² e_z × (e_z × r).

    Args:
        rotation: of the sole, (3, 3).
        axes: position, velocity and acceleration of x, y, z and ψ, (12,) in m and rad.
        mount: placement of the frame in the sole, (12,).
    """
    if len(axes) != 12 or len(mount) != 12 or len(out) != 19:
        raise ValueError("frame_in_swing: wrong sizes")
    sole, frame = np.empty(12), np.empty(12)
    for i in range(3):
        put(sole, 3 * i, (rotation[0, i], rotation[1, i], rotation[2, i]))
    put(sole, 9, (axes[0], axes[3], axes[6]))
    place(sole, mount, frame)
    position, (x, y, _) = three(frame, 9), subtract(three(frame, 9), three(sole, 9))
    put(out, 0, position)
    quaternion(frame, out[3:7])
    rate, change = axes[10], axes[11]
    put(out, 7, (axes[1] - rate * y, axes[4] + rate * x, axes[7]))
    put(out, 10, (0.0, 0.0, rate))
    put(out, 13, (axes[2] - change * y - rate * rate * x, axes[5] + change * x - rate * rate * y, axes[8]))
    put(out, 16, (0.0, 0.0, change))
