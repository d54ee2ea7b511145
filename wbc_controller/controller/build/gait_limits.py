"""Static limits of a gait: reach, velocities, torques, friction."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.controller.build.leg import FeasibleSpeed, Leg, Load, largest_speed, swing_of
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.walking import WalkingSettings
from wbc_controller.walking.feet import Foot
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import Gait, QuadrupedGait
from wbc_controller.walking.quadruped import PointFoot

#: Largest acceleration of a quintic between two points at rest, in distances per squared duration.
_QUINTIC = 10.0 / math.sqrt(3.0)
WAYS = (Velocity(1.0), Velocity(1.0j), Velocity(turning=1.0))  # directions: forward, sideways and turning
_SAFE = 0.8  # safe share of a feasible speed
#: Share of the joint speeds for the steps in place of a quadruped, and smallest share of its wanted clearance.
_MODERATE, _LOWEST = 0.5, 0.4


@dataclass(frozen=True, slots=True)
class BipedLeg:
    """A leg of a biped, with its foot; side 1 is the left one, -1 the right one."""

    side: int
    foot: Foot
    leg: Leg


class BipedLimits:
    """Static limits of a biped's gait in its nominal posture, lowered by `walking.lowering`."""

    def __init__(
        self, model: RobotModel, contacts: Mapping[str, Contact], legs: Sequence[BipedLeg], gait: Gait, speeds: Array
    ) -> None:
        """Prepare the limits for the largest joint speeds, (nj,) in rad/s."""
        self.legs, self.gait = legs, gait
        self._model, self._contacts, self._speeds, self._dynamics = model, contacts, speeds, Dynamics(model)
        self._base = np.setdiff1d(np.arange(model.nv), model.v_index)[:6]  # columns of the base in v

    def feasible(self, way: Velocity, most: float) -> FeasibleSpeed:
        """Return the feasible speed in a direction, at most `most`."""

        def worst(speed: float) -> Load:
            velocity = way.times(speed)
            loads = [each.leg.swing_share(self.swing(velocity, each), self._speeds) for each in self.legs]
            loads += [load for each in self.legs for load in self.support_loads(each, velocity)]
            return max(loads, key=lambda load: load.share)

        return largest_speed(worst, most)

    def swing(self, velocity: Velocity, leg: BipedLeg) -> Iterator[tuple[Array, Array]]:
        """Return the swing of a leg; like in `nominal_step`, steps to the side widen the stance."""
        gait = self.gait
        width = max(gait.width, gait.least_width + abs(velocity.linear.imag) * gait.step_time)
        beside = leg.side * (0.5 * width - abs(leg.leg.place[1]))
        return swing_of(velocity, 2.0 * gait.step_time, gait.single, gait.clearance, gait.lowering, beside)

    def single_support(self) -> dict[str, Load]:
        """Return the largest load of each stance foot, by contact, while the robot steps in place."""
        found = {leg.foot.contact: self.support_loads(leg, Velocity()) for leg in self.legs}
        return {name: max(loads, key=lambda load: load.share) for name, loads in found.items()}

    def support_loads(self, leg: BipedLeg, velocity: Velocity) -> list[Load]:
        """Return the loads of a stance leg at the start, in the middle and at the end of a single support.

        The base has the acceleration a, ψ̈ about the vertical, and the swing leg q̈ = J⁺ a_s. The foot has a_s = ±10/√3 ·
        2 s / T_s² for the step s, and the robot turns by ψ̇ T per step T, in a cosine: ψ̈ = 2π ψ̇ / T.
        The rows of the base give the contact wrench f, and a follows from its centre of pressure in the middle of the
        sole:

            (Jᵀ f)_base = (M v̇ + h)_base,    f_τx = f_τy = 0,    τ = T (M v̇ + h - Jᵀ f).
        """
        gait, model, dynamics, base = self.gait, self._model, self._dynamics, self._base
        contact, moved = self._contacts[leg.foot.contact], 0.5 * velocity.linear.real * gait.single
        swing = next(each.leg for each in self.legs if each is not leg)
        forward = np.zeros(6)
        forward[0] = _QUINTIC * 2.0 * velocity.linear.real * gait.step_time / gait.single**2
        found = []
        for x, sign in ((moved, 1.0), (0.0, 0.0), (-moved, -1.0)):
            posture, reason = self._lowered(leg, x)
            if reason:
                continue  # the swing of this leg has the same reach
            dynamics.update(model.configuration(posture), np.zeros(model.nv))
            rates = np.zeros(model.nv)
            rates[model.v_index[swing.joints]] = swing.rates(posture, sign * forward)
            # In the direction of the swing's moment.
            rates[base[5]] = leg.side * (sign or 1.0) * 2.0 * math.pi * abs(velocity.turning) / gait.step_time
            J, M = contact.jacobian(dynamics), dynamics.M
            by_base = np.linalg.solve(
                J[:, base].T, np.column_stack([M[base] @ rates + dynamics.h[base], M[base][:, base]])
            )
            rates[base[:2]] = np.linalg.solve(by_base[3:5, 1:3], -by_base[3:5, 0])
            f = by_base[:, 0] + by_base[:, 1:3] @ rates[base[:2]]
            found.append(self._torque_load(M @ rates + dynamics.h - J.T @ f))
            # Rows C f ≤ 0 with an allowance -C_z f_z: sliding, turning, centre of pressure.
            allowed = -contact.cone[:, 2] * f[2]
            share = (contact.cone @ f + allowed)[allowed > 0.0] / allowed[allowed > 0.0]
            found.append(Load(float(share.max()), f"friction and size of {contact.name}"))
        return found

    def _lowered(self, leg: BipedLeg, x: float) -> tuple[Array, str]:
        """Return the posture with bent knees and the stance foot forward by x, in m, and the missed limit, or ""."""
        posture, reasons = np.array(self._model.posture), []
        for each in self.legs:
            offset = np.array([x if each is leg else 0.0, 0.0, self.gait.lowering, 0.0])
            posture, reason = each.leg.posture(offset, posture)
            reasons.append(reason)
        return posture, next(filter(None, reasons), "")

    def _torque_load(self, force: Array) -> Load:
        model = self._model
        tau, limits = np.abs(model.actuation.torques(force)), model.effort_limits
        worst = int(np.argmax(tau / limits))
        text = f"torque of {model.actuators[worst]}: {tau[worst]:.1f} of {limits[worst]:g} N·m"
        return Load(float(tau[worst] / limits[worst]), text)


class QuadrupedLimits:
    """Static limits of a quadruped's gait in its nominal posture."""

    def __init__(self, legs: Mapping[PointFoot, Leg], gait: QuadrupedGait, speeds: Array) -> None:
        """Prepare the limits for the largest joint speeds, (nj,) in rad/s."""
        self.gait = gait
        self._legs, self._speeds = legs, speeds

    def raised(self, wanted: float) -> float:
        """Return a clearance in m for which steps in place need a moderate share of the joint speeds."""
        gait, (leg, *_) = self.gait, self._legs.values()

        def load(clearance: float) -> Load:
            share, text = leg.swing_share(swing_of(Velocity(), gait.cycle, gait.swing, clearance), self._speeds)
            return Load(share / _MODERATE, text)

        return max(largest_speed(load, wanted).speed, _LOWEST * wanted)

    def feasible(self, way: Velocity, most: float) -> FeasibleSpeed:
        """Return the feasible speed in a direction, at most `most`."""
        gait = self.gait

        def worst(speed: float) -> Load:
            loads = []
            for foot, leg in self._legs.items():
                # The robot turns about the middle of its feet: v = v_0 + ψ̇ e_z × r
                velocity = Velocity(speed * (way.linear + 1j * way.turning * foot.nominal))
                swing = swing_of(velocity, gait.cycle, gait.swing, gait.clearance, gait.lowering)
                loads.append(leg.swing_share(swing, self._speeds))
            return max(loads, key=lambda load: load.share)

        return largest_speed(worst, most)


def feasible_defaults(limits: BipedLimits | QuadrupedLimits, walking: WalkingSettings) -> tuple[float, float, float]:
    """Return the configured speeds of a gait; by default at most a safe share of the feasible ones."""
    configured = walking.max_speed, walking.max_side_speed, walking.max_turn_rate
    speeds = []
    for way, wanted, fixed in zip(WAYS, limits.gait.speed, configured, strict=True):
        feasible = limits.feasible(way, wanted / _SAFE).speed if fixed is None else 0.0
        speeds.append(fixed if fixed is not None else _SAFE * feasible if feasible > 0.0 else wanted)
    forward, sideways, turning = speeds
    return forward, sideways, turning
