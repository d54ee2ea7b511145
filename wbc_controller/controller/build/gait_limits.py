"""Static limits of a biped's gait: reach and joint velocities of a swing, torques and friction of the stance leg."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.controller.build.leg import FeasibleSpeed, Leg, largest_speed
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import Gait
from wbc_controller.walking.pendulum import natural_frequency

#: Largest acceleration of a quintic between two points at rest, in distances per squared duration.
_QUINTIC = 10.0 / math.sqrt(3.0)

#: Directions: forward, sideways and turning.
WAYS = (Velocity(1.0), Velocity(1.0j), Velocity(turning=1.0))
#: Safe share of a feasible speed.
_SAFE = 0.8


@dataclass(frozen=True, slots=True)
class SupportLoad:
    """Load of a single support: share of the most loaded limit, and its text."""

    share: float
    text: str


class GaitLimits:
    """Static limits of a biped's gait in its nominal posture, lowered by `walking.lowering`."""

    def __init__(
        self, model: RobotModel, contacts: Mapping[str, Contact], legs: Sequence[Leg], gait: Gait, speeds: Array
    ) -> None:
        """Prepare the limits; `speeds` are the largest ones of the joints, (nj,) in rad/s."""
        self.legs, self.gait = legs, gait
        self._model, self._contacts, self._speeds, self._dynamics = model, contacts, speeds, Dynamics(model)
        #: Columns of the base in v.
        self._base = np.setdiff1d(np.arange(model.nv), model.v_index)[:6]

    def feasible(self, way: Velocity, most: float) -> FeasibleSpeed:
        """Return the feasible speed in a direction, at most `most`, in m/s or rad/s."""

        def worst(speed: float) -> tuple[float, str]:
            velocity = way.times(speed)
            swings = [leg.swing_share(velocity, self.gait, self._speeds) for leg in self.legs]
            loads = [(load.share, load.text) for leg in self.legs for load in self.support_loads(leg, velocity)]
            return max([*swings, *loads], key=lambda each: each[0])

        return largest_speed(worst, most)

    def safe_speed(self, way: Velocity, wanted: float) -> float:
        """Return a speed in a direction, or a safe share of the feasible one; the speed itself if none is feasible."""
        found = self.feasible(way, wanted / _SAFE)
        return _SAFE * found.speed if found.speed > 0.0 else wanted

    def single_support(self) -> dict[str, SupportLoad]:
        """Return the largest load of each stance foot, by contact, while the robot steps in place."""
        found = {leg.foot.contact: self.support_loads(leg, Velocity()) for leg in self.legs}
        return {name: max(loads, key=lambda load: load.share) for name, loads in found.items()}

    def support_loads(self, leg: Leg, velocity: Velocity) -> list[SupportLoad]:
        """Return the loads of a stance leg at the ends and in the middle of a single support.

        The robot moves like the linear inverted pendulum, with a = ω² (c - p) of the centre of mass c and the middle p
        of the sole. All links have this acceleration, v̇ = (a, 0), and the rows of the base give the contact wrench f:

            (Jᵀ f)_base = (M v̇ + h)_base + (0, m_z),    τ = T (M v̇ + h - Jᵀ f).

        m_z is the largest moment about the vertical. The leg of mass m_l swings beside the robot at the distance w of
        the feet, with half of the foot's acceleration; the robot turns by ψ̇ T per step T, in a cosine:

            m_z = w m_l / 2 · 10/√3 · 2 |s_x| / T_s² + I_z 2π ψ̇ / T.
        """
        gait, model, dynamics, base = self.gait, self._model, self._dynamics, self._base
        contact, moved = self._contacts[leg.foot.contact], 0.5 * velocity.linear.real * gait.single
        swing_mass = sum(model.pinocchio.inertias[model.pinocchio.getJointId(model.joints[i])].mass for i in leg.joints)
        swings = _QUINTIC * 2.0 * abs(velocity.linear.real) * gait.step_time / gait.single**2
        found = []
        for x in (-moved, 0.0, moved):
            posture, reason = self._lowered(leg, x)
            if reason:
                continue  # the swing of this leg has the same reach
            dynamics.update(model.configuration(posture), np.zeros(model.nv))
            arm = dynamics.com - leg.foot.sole(dynamics).centre
            rates = np.zeros(model.nv)
            rates[base[:2]] = natural_frequency(float(arm[2]), model.gravity) ** 2 * arm[:2]
            inertia = dynamics.centroidal_matrix[5, base[5]]
            turn = inertia * 2.0 * math.pi * abs(velocity.turning) / gait.step_time
            moment = 0.5 * gait.width * swing_mass * swings + turn
            force, J = dynamics.M @ rates + dynamics.h, contact.jacobian(dynamics)
            wanted = force[base]
            wanted[5] += leg.side * moment  # the other leg swings forward
            f = np.linalg.solve(J[:, base].T, wanted)
            found += [self._torque_load(force - J.T @ f), self._friction_load(contact.name, contact.cone, f)]
        return found

    def _lowered(self, leg: Leg, x: float) -> tuple[Array, str]:
        """Return the posture with bent knees and the stance foot at a place x forward, in m, and why not, or ""."""
        posture, reasons = np.array(self._model.posture), []
        for each in self.legs:
            offset = np.array([x if each is leg else 0.0, 0.0, self.gait.lowering, 0.0])
            posture, reason = each.posture(offset, posture)
            reasons.append(reason)
        return posture, next(filter(None, reasons), "")

    def _torque_load(self, force: Array) -> SupportLoad:
        model = self._model
        tau, limits = np.abs(model.actuation.torques(force)), model.effort_limits
        worst = int(np.argmax(tau / limits))
        text = f"torque of {model.actuators[worst]}: {tau[worst]:.1f} of {limits[worst]:g} N·m"
        return SupportLoad(float(tau[worst] / limits[worst]), text)

    def _friction_load(self, name: str, cone: Array, f: Array) -> SupportLoad:
        """Return the load of the rows C f ≤ 0 with an allowance -C_z f_z: sliding, turning, centre of pressure."""
        allowed = -cone[:, 2] * f[2]
        share = (cone @ f + allowed)[allowed > 0.0] / allowed[allowed > 0.0]
        return SupportLoad(float(share.max()), f"friction and size of {name}")
