"""The hoist that holds the mock robot's base at its start, and is engaged and released along ramps."""

import math
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.simulation.mechanism import HOIST, IMPEDANCE, STIFF_STEPS, position_and_wxyz

#: Time over which the hoist is engaged or released, s: long enough to avoid a kick.
RAMP = 0.3
#: Speeds at which it carries a displaced base back to its start, m/s and rad/s.
SPEED, TURN = 0.5, 1.0


class Hoist:
    """A weld between world and base, whose strength and placement follow ramps.

    Attributes:
        start: placement in the world at which it holds the base.
    """

    def __init__(self, model: Any, data: Any, start: pin.SE3) -> None:
        """Hold the base at `start`, at full strength, by the weld in MuJoCo's model."""
        self.start = start
        self._model = model
        self._data = data
        self._id = model.equality(HOIST).id
        self._step = float(model.opt.timestep)
        self._strength, self._rate = 1.0, 0.0
        self._from, self._way, self._way_rate = start, 1.0, 0.0
        self._write()

    @property
    def held(self) -> bool:
        """True if it holds the base, or is being engaged."""
        return self._rate > 0.0 or (self._rate == 0.0 and self._strength == 1.0)

    def take(self, base: pin.SE3, ramp: float) -> None:
        """Engage at the present placement of the base within `ramp`, s, and carry it to the start."""
        self._from, self._way = base, 0.0
        way = pin.log6(base.actInv(self.start)).vector
        seconds = max(np.linalg.norm(way[:3]) / SPEED, np.linalg.norm(way[3:]) / TURN)
        self._way_rate = 1.0 / max(1, math.ceil(seconds / self._step))
        self._set_off(1.0, ramp)

    def let_go(self, ramp: float) -> None:
        """Release the base within `ramp`, s."""
        self._set_off(-1.0, ramp)

    def advance(self) -> None:
        """Advance the ramps by one step."""
        if self._rate == 0.0 and self._way_rate == 0.0:
            return
        self._strength = min(1.0, max(0.0, self._strength + self._rate))
        self._way = min(1.0, self._way + self._way_rate)
        if self._strength in (0.0, 1.0):
            self._rate = 0.0
        if self._way == 1.0:
            self._way_rate = 0.0
        self._write()

    def _set_off(self, sign: float, ramp: float) -> None:
        self._rate = sign * (self._step / ramp if ramp > 0.0 else 1.0)
        if not ramp > 0.0:
            self.advance()

    def _write(self) -> None:
        target = pin.SE3.Interpolate(self._from, self.start, self._way)
        self._model.eq_data[self._id, 3:10] = position_and_wxyz(target)
        # The impedance d blends the free acceleration with that of a spring, (1 - d) a_free + d (-k r - b dr/dt): a
        # ramp of d to zero releases the base without a kick. MuJoCo divides k and b by d, which is undone here.
        d = IMPEDANCE * self._strength
        time_constant = STIFF_STEPS * self._step
        self._model.eq_solref[self._id] = -d / time_constant**2, -2.0 * d / time_constant
        self._model.eq_solimp[self._id, :2] = d
        self._data.eq_active[self._id] = self._strength > 0.0
