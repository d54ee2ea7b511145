"""Actuator faults."""

from collections import deque
from typing import Any

import numpy as np
from pydantic import Field

from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, FaultContext, JointFault, number, restoring
from wbc_controller.simulation.mechanism import add_friction

_PLACE = "actuators"
_NO_LIMIT = 100.0  # reference torque of joints without actuator, N·m


class _AllActuators(Fault):
    place = _PLACE


class _OneActuator(_AllActuators):
    actuator: str = Field("", description="name of the actuator; random if empty")

    def _start(self, context: FaultContext) -> Any:
        return context.index_of(self.actuator, context.robot.actuators)


class ActuatorDead(_OneActuator):
    """An actuator has no torque."""

    def _change(self, tau: Array, context: FaultContext, state: int) -> Array:
        return _scaled(tau, state, 0.0)


class ActuatorReversed(_OneActuator):
    """The torque of an actuator has the wrong sign."""

    def _change(self, tau: Array, context: FaultContext, state: int) -> Array:
        return _scaled(tau, state, -1.0)


class ActuatorGain(_OneActuator):
    """The torque of an actuator is scaled, as by a wrong torque constant."""

    factor: float = number(0.8, 0.2, 2.0, "", "scale of the torque")

    def _change(self, tau: Array, context: FaultContext, state: int) -> Array:
        return _scaled(tau, state, self.factor)


class ActuatorWeak(_AllActuators):
    """All actuators saturate below their effort limits, as with a weak battery."""

    share: float = number(0.5, 0.02, 0.95, "", "remaining share of the effort limits")

    def _change(self, tau: Array, context: FaultContext, state: Any) -> Array:
        most = self.share * context.plant.effort_limits
        return np.asarray(np.clip(tau, -most, most))


class ActuatorBias(_OneActuator):
    """The torque of an actuator has an offset."""

    share: float = number(0.05, -0.5, 0.5, "", "offset as a share of the effort limit")

    def _change(self, tau: Array, context: FaultContext, state: int) -> Array:
        changed: Array = tau.copy()
        changed[state] += self.share * context.plant.effort_limits[state]
        return changed


class ActuatorNoise(_AllActuators):
    """White noise on the torques of all actuators."""

    share: float = number(0.01, 0.001, 0.2, "", "standard deviation as a share of the effort limits")

    def _change(self, tau: Array, context: FaultContext, state: Any) -> Array:
        return tau + context.rng.normal(0.0, self.share * context.plant.effort_limits)


class ActuatorLag(_AllActuators):
    """First-order low-pass on the torques of all actuators."""

    time_constant: float = number(0.005, 0.001, 0.05, "s", "time constant")

    def _change(self, tau: Array, context: FaultContext, state: Any) -> Array:
        return context.low_pass("torques", tau, self.time_constant)


class ActuatorDelay(_AllActuators):
    """All torques are delayed."""

    delay: float = number(0.004, 0.002, 0.05, "s", "delay, rounded to control periods")

    def _start(self, context: FaultContext) -> deque[Array]:
        return deque(maxlen=max(1, round(self.delay / context.period)) + 1)

    def _change(self, tau: Array, context: FaultContext, state: deque[Array]) -> Array:
        state.append(tau)
        return state[0]


class JointFriction(JointFault):
    """A joint has dry friction."""

    place = _PLACE
    share: float = number(0.05, 0.005, 0.8, "", "share of the effort limit, or of 100 N·m without limit")

    def begin(self, context: FaultContext) -> Effect:
        """Add the friction to the physics."""
        joint, model = self._start(context), context.plant.model
        limits = context.robot.actuation.at_joints(context.plant.effort_limits)
        dof = int(model.joint(context.robot.joints[joint]).dofadr[0])
        effect = restoring((model.dof_frictionloss, dof), (model.dof_solref, dof), (model.dof_solimp, dof))
        add_friction(model, dof, self.share * (abs(float(limits[joint])) or _NO_LIMIT), context.plant.step_seconds)
        return effect


class JointLocked(JointFault):
    """A joint is locked at its position."""

    place = _PLACE

    def begin(self, context: FaultContext) -> Effect:
        """Lock the joint."""
        return Effect(ended=context.plant.lock(context.robot.joints[self._start(context)]))


def _scaled(tau: Array, actuator: int, factor: float) -> Array:
    changed: Array = tau.copy()
    changed[actuator] *= factor
    return changed
