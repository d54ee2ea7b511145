"""Lower bound of the comparison: `pinocchio.computeAllTerms` and one Cholesky factorization.

The matrix has the size of accelerations and forces.
"""

import time
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack
from serving import describe, serve


class Floor:
    """Terms of the equations of motion, and one factorization."""

    def __init__(self, scene: dict[str, Any]) -> None:
        self.model = pin.buildModelFromXML(scene["urdf"], pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        size = self.model.nv + sum(3 if contact["type"] == "point" else 6 for contact in scene["contacts"])
        root = np.random.default_rng(0).normal(size=(size, size))
        self.matrix = np.asfortranarray(root @ root.T + size * np.eye(size))
        self.hello = describe(f"Pinocchio {pin.__version__}", (size, 0, 0), (0, 0, 0), ("terms", "factorization"))

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Time one state."""
        del reference
        started = time.perf_counter()
        pin.computeAllTerms(self.model, self.data, q, v)
        known = time.perf_counter()
        lapack.dpotrf(self.matrix)
        ended = time.perf_counter()
        return np.array([known - started, ended - known, ended - started])


if __name__ == "__main__":
    serve(Floor)
