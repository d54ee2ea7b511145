"""Hoist of the mock robot."""

import math
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.simulation.mechanism import HOIST, IMPEDANCE, STIFF_STEPS
from wbc_controller.simulation.shapes import wxyz

RAMP = 0.3  # duration of engaging or releasing, s
SPEED, TURN = 0.5, 1.0  # speeds of the return to the start, m/s and rad/s


class Hoist:
    """Weld between world and base with ramps of strength and placement; `start` is the held placement."""

    def __init__(self, model: Any, data: Any, start: pin.SE3) -> None:
        self.start = start
        self._model = model
        self._data = data
        self._id = model.equality(HOIST).id
        self._step = float(model.opt.timestep)
        self._strength, self._rate = 1.0, 0.0
        self._from, self._progress, self._progress_rate = start, 1.0, 0.0
        self._write()

    @property
    def held(self) -> bool:
        """True if the base is held, or the hoist is being engaged."""
        return self._rate > 0.0 or (self._rate == 0.0 and self._strength == 1.0)

    def hold(self, held: bool, base: pin.SE3, ramp: float) -> None:
        """Hold the base within `ramp`, s, and move it from its placement to the start, or release it."""
        if held:
            self._from, self._progress = base, 0.0
            way = pin.log6(base.actInv(self.start)).vector
            seconds = max(np.linalg.norm(way[:3]) / SPEED, np.linalg.norm(way[3:]) / TURN)
            self._progress_rate = 1.0 / max(1, math.ceil(seconds / self._step))
        rate = self._step / ramp if ramp > 0.0 else 1.0
        self._rate = rate if held else -rate
        if not ramp > 0.0:
            self.advance()

    def advance(self) -> None:
        """Advance the ramps by one step."""
        if self._rate == 0.0 and self._progress == 1.0:
            return
        self._strength = min(1.0, max(0.0, self._strength + self._rate))
        self._progress = min(1.0, self._progress + self._progress_rate)
        if self._strength in (0.0, 1.0):
            self._rate = 0.0
        self._write()

    def _write(self) -> None:
        target = pin.SE3.Interpolate(self._from, self.start, self._progress)
        self._model.eq_data[self._id, 3:10] = [*target.translation, *wxyz(target.rotation)]
        # The impedance d blends free and spring acceleration, (1 - d) a_free + d (-k r - b dr/dt), without a jerk at
        # release. MuJoCo divides k and b by d, which is undone here.
        d = IMPEDANCE * self._strength
        time_constant = STIFF_STEPS * self._step
        self._model.eq_solref[self._id] = -d / time_constant**2, -2.0 * d / time_constant
        self._model.eq_solimp[self._id, :2] = d
        self._data.eq_active[self._id] = self._strength > 0.0
