"""Faults of the actuators: the torques at the joints differ from the commanded ones."""

from collections import deque
from typing import Any

import numpy as np

from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import (
    ActuatorFault,
    Effect,
    Fault,
    JointFault,
    Site,
    TorqueFault,
    low_pass,
    number,
)
from wbc_controller.simulation.mechanism import rub

_PLACE = "actuators"
#: Torque to which the share of friction refers at joints without an actuator, N·m.
_NO_LIMIT = 100.0


class _AllActuators(TorqueFault):
    place = _PLACE


class _OneActuator(ActuatorFault, TorqueFault):
    place = _PLACE


class ActuatorDead(_OneActuator):
    """An actuator gives no torque."""

    def _change(self, tau: Array, site: Site, kept: int) -> Array:
        return _scaled(tau, kept, 0.0)


class ActuatorReversed(_OneActuator):
    """An actuator turns the wrong way."""

    def _change(self, tau: Array, site: Site, kept: int) -> Array:
        return _scaled(tau, kept, -1.0)


class ActuatorGain(_OneActuator):
    """An actuator gives another share of what is commanded, as with a wrong torque constant."""

    factor: float = number(0.8, 0.2, 2.0, "", "by which its torque is multiplied")

    def _change(self, tau: Array, site: Site, kept: int) -> Array:
        return _scaled(tau, kept, self.factor)


class ActuatorWeak(_AllActuators):
    """All actuators saturate below their effort limits, as with a weak battery."""

    share: float = number(0.5, 0.02, 0.95, "", "of the effort limits that is left")

    def _change(self, tau: Array, site: Site, kept: Any) -> Array:
        most = self.share * site.plant.effort_limits
        return np.asarray(np.clip(tau, -most, most))


class ActuatorBias(_OneActuator):
    """An actuator gives a torque beside what is commanded."""

    share: float = number(0.05, -0.5, 0.5, "", "of its effort limit that is added")

    def _change(self, tau: Array, site: Site, kept: int) -> Array:
        changed: Array = tau.copy()
        changed[kept] += self.share * site.plant.effort_limits[kept]
        return changed


class ActuatorNoise(_AllActuators):
    """White noise on the torques of all actuators."""

    share: float = number(0.01, 0.001, 0.2, "", "of the effort limits, the standard deviation")

    def _change(self, tau: Array, site: Site, kept: Any) -> Array:
        return tau + site.rng.normal(0.0, self.share * site.plant.effort_limits)


class ActuatorLag(_AllActuators):
    """The torques of all actuators pass through a low-pass filter of first order."""

    time_constant: float = number(0.005, 0.001, 0.05, "s", "of the filter")

    def _change(self, tau: Array, site: Site, kept: dict[str, Array]) -> Array:
        return low_pass(site, self.time_constant, kept, "torques", tau)


class ActuatorDelay(_AllActuators):
    """The torques of all actuators act later."""

    delay: float = number(0.004, 0.002, 0.05, "s", "until they act, rounded to control periods")

    def _start(self, site: Site) -> deque[Array]:
        return deque(maxlen=max(1, round(self.delay / site.period)) + 1)

    def _change(self, tau: Array, site: Site, kept: deque[Array]) -> Array:
        kept.append(tau)
        return kept[0]


class JointFriction(JointFault):
    """A joint has dry friction."""

    place = _PLACE
    share: float = number(0.05, 0.005, 0.8, "", "of its effort limit, or of 100 N·m where it has none")

    def begin(self, site: Site) -> Effect:
        """Add the friction to the physics."""
        joint, model = self._start(site), site.plant.model
        limits = site.robot.actuation.at_joints(site.plant.effort_limits)
        dof = int(model.joint(site.robot.joints[joint]).dofadr[0])
        friction, stiffness, impedance = model.dof_frictionloss, model.dof_solref, model.dof_solimp
        before = float(friction[dof]), stiffness[dof].copy(), impedance[dof].copy()
        rub(model, dof, self.share * (abs(float(limits[joint])) or _NO_LIMIT), site.plant.step_seconds)

        def end() -> None:
            friction[dof], stiffness[dof], impedance[dof] = before

        return Effect(ended=end)


class JointLocked(JointFault):
    """A joint does not move any more."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Lock it at its present position."""
        return Effect(ended=site.plant.lock(site.robot.joints[self._start(site)]))


def _scaled(tau: Array, actuator: int, factor: float) -> Array:
    """Multiply the torque of one actuator."""
    changed: Array = tau.copy()
    changed[actuator] *= factor
    return changed


KINDS: tuple[type[Fault], ...] = (
    ActuatorDead, ActuatorReversed, ActuatorGain, ActuatorWeak, ActuatorBias, ActuatorNoise, ActuatorLag, ActuatorDelay,
    JointFriction, JointLocked,
)  # fmt: skip
