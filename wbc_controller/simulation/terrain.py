"""Blocks of ground, rigid or soft.

A contact of MuJoCo with the impedance d and ``solref`` (-k, -b) has the force (k r + b ṙ) / ((1 - d) A) at the depth r,
with the inverse mass A of the two bodies (`body_invweight0`): k = K (1 - d) A gives the stiffness K in N/m.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.records import Array
from wbc_controller.settings.service import TerrainSettings
from wbc_controller.simulation.shapes import wxyz

TERRAIN = "terrain/"  # prefix of the names of blocks' geoms
SOFT_IMPEDANCE = 0.5  # impedance of soft ground: it adds d / (1 - d) of the mass of a foot


def blocks(terrain: TerrainSettings) -> list[tuple[pin.SE3, Array]]:
    """Return placements of centres and half sizes, (3,) in m, of the boxes of a block."""
    edge = pin.SE3(pin.rpy.rpyToMatrix(*terrain.rpy), np.array(terrain.position))
    length, width, thickness = terrain.size
    nx, ny = terrain.cells
    heights = np.random.default_rng(terrain.seed).uniform(-terrain.unevenness, terrain.unevenness, (nx, ny))
    half = 0.5 * np.array([length / nx, width / ny, thickness])
    x, y = length * (np.arange(nx) + 0.5) / nx, width * ((np.arange(ny) + 0.5) / ny - 0.5)
    centres = [np.array([x[i], y[j], heights[i, j] - half[2]]) for i, j in np.ndindex(nx, ny)]
    return [(edge * pin.SE3(np.eye(3), centre), half) for centre in centres]


def add_terrain(spec: Any, name: str, terrain: TerrainSettings, options: Mapping[str, Any]) -> None:
    """Add the boxes of a block, with options of their geoms, to a MuJoCo specification."""
    for index, (placement, half) in enumerate(blocks(terrain)):
        box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "name": f"{TERRAIN}{name}/{index}", "size": half}
        spec.worldbody.add_geom(**box, **options, pos=placement.translation, quat=wxyz(placement.rotation))


def soften(model: Any, terrain: Mapping[str, TerrainSettings], bodies: Iterable[int]) -> None:
    """Set stiffness and damping of soft blocks in a compiled model, for the mean inverse mass of the feet's bodies."""
    feet = list(bodies)
    if not feet:
        return
    scale = (1.0 - SOFT_IMPEDANCE) * float(np.mean(model.body_invweight0[feet, 0]))
    for name, block in terrain.items():
        if block.stiffness is None:
            continue
        for index in range(len(blocks(block))):
            geom = model.geom(f"{TERRAIN}{name}/{index}")
            geom.solref[:] = -scale * block.stiffness, -scale * block.damping
            geom.solimp[:2] = SOFT_IMPEDANCE
