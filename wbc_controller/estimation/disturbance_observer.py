"""What the model lacks, as slow generalized forces: friction, torques that do not arrive as sent, wrong masses.

With a disturbance d, (nv,), the equations of motion of the quadratic program are M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + d. They
predict v̇ from the torques sent; what the robot does instead tells how wrong d is,

    ḋ = Nᵀ M (v̇_measured - v̇_predicted) / T - d / (25 T),      N = I - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J,

as the disturbance observer of robot arms does (De Luca, Mattone, "Sensorless robot collision detection and hybrid
force/motion control", ICRA 2005), but with the accelerations of the program, whose contact forces are chosen with d. Nᵀ
(`projection`) keeps what can move the robot on its contacts: forces of contacts that no motion shows, and noise along
them, do not count. So tasks have an integral action, for all of them at once and within all limits. It is slow against
pushes, bounded, and forgets.

Where a component is at its bound, the motion goes on to show what the bound has cut off, and shows it along other
components too, as Nᵀ joins them. So d is remembered without its bounds, and Nᵀ times what they cut off is taken from
the residual. Otherwise one component at its bound would wind all others up to theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbc_controller.estimation.projection import parts
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, frozen

#: Time in which it forgets, as a multiple of its time constant: it leaves a twenty-fifth of what it takes up.
_LEAK = 25.0
#: Lever of the moments that the base may lack, for a share of the robot's weight, m.
_LEVER = 0.1
#: Time over which residuals are summed up before they are projected, s.
_SUMMED = 0.01
#: Time constant with which what is no longer asked for fades, s.
_FADE = 0.3
#: Size below which a fading estimate is none, as a share of its bound.
_NOTHING = 1.0e-4


@dataclass(frozen=True, slots=True)
class DisturbanceLimits:
    """How fast the estimate follows, and how large it gets.

    Attributes:
        time_constant: T, s.
        share: largest size, as a share of the joints' torques and of the robot's weight.
        on: whether it follows; otherwise it fades, and is none then.
    """

    time_constant: float
    share: float
    on: bool = True


class DisturbanceEstimate:
    """Generalized forces that the model lacks.

    Attributes:
        limits: how fast it follows.
        forces: the present estimate, d, (nv,) in N, N·m.
        at_bound: names of the joints, and ``base``, at which it is as large as it may be.
        held: the mean force that the contacts took up beyond their prediction, (k,), and over how long, s; None but at
            the end of a sum in which all was predicted.
    """

    MEMORY = ("forces", "at_bound", "_unbounded", "_contacts", "_sum", "_time", "_whole_sum")

    def __init__(self, model: RobotModel, limits: DisturbanceLimits) -> None:
        """Begin with none.

        Args:
            model: the robot's model.
            limits: how fast it follows.
        """
        self.limits = limits
        self._whole = np.zeros(model.nv)  # what a share of 1 is
        if model.floating_base:
            weight = model.mass * model.gravity
            self._whole[:3], self._whole[3:6] = weight, _LEVER * weight
        torques = np.abs(model.actuation.ratios).T @ model.effort_limits
        self._whole[model.v_places] = torques
        self._names = np.full(model.nv, "base", dtype=object)
        self._names[model.v_places] = model.joints
        self.restart()

    def restart(self) -> None:
        """Forget all."""
        self.forces = self._unbounded = self._judged = frozen(np.zeros(len(self._whole)))
        self._acts = False  # whether those that were judged last are any
        self.at_bound: tuple[str, ...] = ()
        self.held: tuple[Array, float] | None = None
        self._begin(())

    def _begin(self, contacts: tuple[str, ...]) -> None:
        self._contacts, self._sum, self._time = contacts, np.zeros(len(self._whole)), 0.0
        self._whole_sum = True  # whether all of it was predicted

    @property
    def rests(self) -> bool:
        """Whether it is none, and stays so."""
        if self.limits.on:
            return False
        if self.forces is not self._judged:  # it is another object after each change
            self._judged, self._acts = self.forces, bool(self.forces.any())
        return not self._acts

    def look(self, M: Array, J: Array, contacts: tuple[str, ...], gap: float, missed: Array | None) -> None:
        """Take what came of a prediction.

        Args:
            M: mass matrix in the state that the prediction began from, (nv, nv).
            J: Jacobian of the contacts that held, (k, nv).
            contacts: their names.
            gap: time to the state that it is compared with, s.
            missed: the generalized impulse by which it has moved more than was predicted, M Δv, (nv,) in N·s, N·m·s;
                None where nothing was predicted.
        """
        self.held = None
        if contacts != self._contacts:
            self._begin(contacts)
        if missed is not None:
            self._sum = self._sum + missed
        else:
            self._whole_sum = False
        self._time += gap
        if self._time < _SUMMED:
            return
        if not self.limits.on:
            forces = self.forces * max(0.0, 1.0 - self._time / _FADE)
            unbounded = forces = forces if (np.abs(forces) > _NOTHING * self._whole).any() else np.zeros(len(forces))
            self.at_bound = ()
        else:
            T, most = self.limits.time_constant, self.limits.share * self._whole
            unexpected, held = parts(M, J, self._sum)
            if self._whole_sum:
                self.held = held / self._time, self._time
            before = self._unbounded
            beyond = before - self.forces
            if beyond.any():
                unexpected = unexpected - parts(M, J, self._time * beyond)[0]
            unbounded = before + (unexpected - self._time / _LEAK * before) / max(T, self._time)
            forces = np.clip(unbounded, -most, most)
            self.at_bound = tuple(dict.fromkeys(self._names[(np.abs(unbounded) > most) & (most > 0.0)].tolist()))
        self.forces, self._unbounded = frozen(forces), frozen(unbounded)
        self._begin(contacts)
