"""Faults of the actuators: what acts at the joints is not what was commanded."""

from __future__ import annotations

from collections import deque

import numpy as np

from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import ActuatorFault, Effect, Fault, JointFault, Site, at_once, number
from wbc_controller.simulation.mechanism import rub

_PLACE = "actuators"


class _AllActuators(Fault):
    """A fault of all actuators."""

    place = _PLACE


class _OneActuator(ActuatorFault):
    """A fault of one actuator."""

    place = _PLACE


class _OneJoint(JointFault):
    """A fault at one joint."""

    place = _PLACE


class ActuatorDead(_OneActuator):
    """An actuator gives no torque."""

    def begin(self, site: Site) -> Effect:
        """Take its torque away."""
        return _scaled(site, self.actuator, 0.0)


class ActuatorReversed(_OneActuator):
    """An actuator turns the wrong way."""

    def begin(self, site: Site) -> Effect:
        """Turn the sign of its torque."""
        return _scaled(site, self.actuator, -1.0)


class ActuatorGain(_OneActuator):
    """An actuator gives another share of what is commanded, as with a wrong torque constant."""

    factor: float = number(0.8, 0.2, 2.0, "", "by which its torque is multiplied")

    def begin(self, site: Site) -> Effect:
        """Scale its torque."""
        return _scaled(site, self.actuator, self.factor)


class ActuatorWeak(_AllActuators):
    """All actuators saturate below their effort limits, as with a weak battery."""

    share: float = number(0.5, 0.02, 0.95, "", "of the effort limits that is left")

    def begin(self, site: Site) -> Effect:
        """Clip the torques."""
        most = self.share * site.plant.effort_limits
        return Effect(torques=lambda tau: np.clip(tau, -most, most))


class ActuatorBias(_OneActuator):
    """An actuator gives a torque beside what is commanded."""

    share: float = number(0.05, -0.5, 0.5, "", "of its effort limit that is added")

    def begin(self, site: Site) -> Effect:
        """Add the torque."""
        added = np.zeros(site.robot.na)
        actuator = site.one_of(self.actuator, site.robot.actuators)
        added[actuator] = self.share * site.plant.effort_limits[actuator]
        return Effect(torques=lambda tau: tau + added)


class ActuatorNoise(_AllActuators):
    """White noise on the torques of all actuators."""

    share: float = number(0.01, 0.001, 0.2, "", "of the effort limits, the standard deviation")

    def begin(self, site: Site) -> Effect:
        """Add new noise in each period."""
        sigma = self.share * site.plant.effort_limits
        return Effect(torques=lambda tau: tau + site.rng.normal(0.0, sigma))


class ActuatorLag(_AllActuators):
    """The torques of all actuators pass through a low-pass filter of first order."""

    time_constant: float = number(0.005, 0.001, 0.05, "s", "of the filter")

    def begin(self, site: Site) -> Effect:
        """Filter from the first command on."""
        keep = float(np.exp(-site.period / self.time_constant))
        past: list[Array] = []

        def lag(tau: Array) -> Array:
            past[:] = [keep * (past[0] if past else tau) + (1.0 - keep) * tau]
            return past[0]

        return Effect(torques=lag)


class ActuatorDelay(_AllActuators):
    """The torques of all actuators act later."""

    delay: float = number(0.004, 0.002, 0.05, "s", "until they act, rounded to control periods")

    def begin(self, site: Site) -> Effect:
        """Keep the torques of the last periods."""
        past: deque[Array] = deque(maxlen=max(1, round(self.delay / site.period)) + 1)

        def delay(tau: Array) -> Array:
            past.append(tau)
            return past[0]

        return Effect(torques=delay)


class JointFriction(_OneJoint):
    """A joint has dry friction."""

    share: float = number(0.05, 0.005, 0.8, "", "of its effort limit, or of 100 N·m where it has none")

    def begin(self, site: Site) -> Effect:
        """Add the friction to the physics."""
        joint = site.one_of(self.joint, site.robot.joints)
        limits = site.robot.actuation.at_joints(site.plant.effort_limits)
        dof = int(site.plant.model.joint(site.robot.joints[joint]).dofadr[0])
        model = site.plant.model
        friction, stiffness, impedance = model.dof_frictionloss, model.dof_solref, model.dof_solimp
        before = float(friction[dof]), stiffness[dof].copy(), impedance[dof].copy()
        rub(model, dof, self.share * (abs(float(limits[joint])) or _NO_LIMIT), site.plant.step_seconds)

        def restore() -> None:
            friction[dof], stiffness[dof], impedance[dof] = before

        return Effect(ended=at_once(restore))


class JointLocked(_OneJoint):
    """A joint does not move any more."""

    def begin(self, site: Site) -> Effect:
        """Lock it where it is."""
        joint = site.robot.joints[site.one_of(self.joint, site.robot.joints)]
        return Effect(ended=at_once(site.plant.lock(joint)))


def _scaled(site: Site, actuator: str, factor: float) -> Effect:
    """Multiply the torque of one actuator."""
    factors = np.ones(site.robot.na)
    factors[site.one_of(actuator, site.robot.actuators)] = factor
    return Effect(torques=lambda tau: factors * tau)


#: Torque that friction is a share of at joints that no actuator drives, N·m.
_NO_LIMIT = 100.0

KINDS: tuple[type[Fault], ...] = (
    ActuatorDead, ActuatorReversed, ActuatorGain, ActuatorWeak, ActuatorBias, ActuatorNoise, ActuatorLag, ActuatorDelay,
    JointFriction, JointLocked,
)  # fmt: skip
