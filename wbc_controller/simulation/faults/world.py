"""Faults of world and model."""

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, FaultContext, number, restoring
from wbc_controller.simulation.mechanism import FLOOR
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.shapes import wxyz

_KICK = 0.02  # duration of a kick, s
_AT_REST = 1.0e-3  # largest penetration of a foot at which the floor returns below it, m


class _WorldFault(Fault):
    place = "world and model"


class _LinkFault(_WorldFault):
    link: str = Field("", description="URDF link; the base if empty")


class _FloorFault(_WorldFault):
    """Fault of the floor; no effect on robots without contacts."""

    def begin(self, context: FaultContext) -> Effect:
        return self._begin(context) if context.plant.contacts else Effect()

    def _begin(self, context: FaultContext) -> Effect:
        raise NotImplementedError


class Payload(_LinkFault):
    """A payload is attached to a link."""

    share: float = number(0.05, 0.005, 0.5, "", "share of the robot's mass")

    def begin(self, context: FaultContext) -> Effect:
        """Add the mass to the link."""
        body = context.plant.body(self.link or context.robot.base_link)
        masses = np.zeros(context.plant.model.nbody)
        masses[body] = self.share * context.robot.mass
        return _add_masses(context.plant, masses)


class MassError(_WorldFault):
    """All masses and inertias differ from the model."""

    share: float = number(0.1, -0.4, 0.4, "", "added share of each mass")

    def begin(self, context: FaultContext) -> Effect:
        """Add the masses."""
        return _add_masses(context.plant, self.share * context.plant.model.body_mass)


class CenterOfMassError(_WorldFault):
    """The base's centre of mass differs from the model."""

    offset: float = number(0.02, 0.002, 0.2, "m", "horizontal, in a random direction")

    def begin(self, context: FaultContext) -> Effect:
        """Shift the base's centre of mass."""
        model, body = context.plant.model, context.plant.body(context.robot.base_link)
        effect = restoring((model.body_ipos, body))
        model.body_ipos[body] += self.offset * context.direction
        model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # disables MuJoCo's shortcut
        return effect


class SlipperyFloor(_FloorFault):
    """The floor is slippery below one foot or all."""

    contact: str = Field("", description="contact; all if empty")
    friction: float = number(0.1, 0.0, 0.5, "", "friction coefficient")

    def _begin(self, context: FaultContext) -> Effect:
        model, touch = context.plant.model, context.plant.contact_forces
        geoms = touch.geoms[self.contact] if self.contact else touch.ground
        effect = restoring((model.geom_friction, geoms), (model.geom_priority, geoms))
        model.geom_friction[geoms, 0] = self.friction
        if self.contact:
            model.geom_priority[geoms] = model.geom_priority.max() + 1
        return effect


class SoftFloor(_FloorFault):
    """The floor is compliant."""

    time_constant: float = number(0.05, 0.01, 0.2, "s", "time constant of sinking feet")

    def _begin(self, context: FaultContext) -> Effect:
        solref, ground = context.plant.model.geom_solref, context.plant.contact_forces.ground
        effect = restoring((solref, ground))
        solref[ground] = self.time_constant, 1.0
        return effect


class FloorDrop(_FloorFault):
    """The floor sinks at once and stays: the robot falls onto it."""

    depth: float = number(0.05, 0.002, 0.5, "m", "depth")

    def _begin(self, context: FaultContext) -> Effect:
        _movable_floor(context.plant).pos[2] -= self.depth
        return Effect()


class FloorHole(_FloorFault):
    """There is no floor below one foot, until the foot is above the floor again after the end."""

    contact: str = Field("", description="contact; random if empty")

    def _begin(self, context: FaultContext) -> Effect:
        model, names = context.plant.model, tuple(context.plant.contacts)
        foot = names[context.index_of(self.contact, names)]
        geoms = context.plant.contact_forces.geoms[foot]
        before = model.geom_conaffinity[geoms].copy()
        model.geom_conaffinity[geoms] = 0

        def ended() -> bool:
            above = context.plant.contact_forces.distance(context.plant.data, geoms) >= -_AT_REST
            if above:
                model.geom_conaffinity[geoms] = before
            return above

        return Effect(ended=ended)


class FloorTilt(_FloorFault):
    """The floor tilts about a horizontal axis below the base, and stays tilted."""

    angle: float = number(0.05, 0.005, 0.4, "rad", "tilt")
    ramp: float = number(0.5, 0.1, 1.0, "s", "duration of the ramp")

    def _begin(self, context: FaultContext) -> Effect:
        plant, floor = context.plant, _movable_floor(context.plant)
        rotation = rotation_of(floor.quat[[1, 2, 3, 0]])
        centre = np.array([*plant.state()[0][:2], 0.0])
        centre[2] = -float(rotation[:2, 2] @ (centre[:2] - floor.pos[:2])) / rotation[2, 2] + floor.pos[2]

        def tilt() -> None:
            turn = pin.exp3(self.angle * context.ramp_share(self.ramp) * context.direction)
            floor.pos[:], floor.quat[:] = centre, wxyz(turn @ rotation)

        return Effect(each_period=tilt)


class Push(_LinkFault):
    """A constant horizontal force on a link."""

    share: float = number(0.1, 0.01, 1.0, "", "share of the robot's weight, in a random direction")

    def begin(self, context: FaultContext) -> Effect:
        """Push for the remaining time."""
        force = self.share * context.robot.mass * context.robot.gravity * context.direction
        return _push(context, self.link, force, max(context.end - context.plant.time, context.period))


class Kick(_LinkFault):
    """A short impulse on a link, independent of the duration."""

    speed: float = number(0.2, 0.02, 2.0, "m/s", "impulse per mass of the robot, horizontal, in a random direction")

    def begin(self, context: FaultContext) -> Effect:
        """Push for a short time."""
        return _push(context, self.link, self.speed * context.robot.mass / _KICK * context.direction, _KICK)


def _push(context: FaultContext, link: str, force: Array, duration: float) -> Effect:
    context.plant.push(link or context.robot.base_link, [*force.tolist(), 0.0, 0.0, 0.0], duration)
    return Effect()  # the push ends itself


def _add_masses(plant: Plant, masses: Array) -> Effect:
    model = plant.model
    mass, inertia = model.body_mass.copy(), model.body_inertia.copy()
    factors = np.divide(masses, mass, out=np.zeros_like(mass), where=mass > 0.0)
    model.body_mass[:] = mass + masses
    model.body_inertia[:] = inertia * (1.0 + factors)[:, None]
    _set_constants(model)

    def ended() -> None:
        model.body_mass[:], model.body_inertia[:] = mass, inertia
        _set_constants(model)

    return Effect(ended=ended)


def _set_constants(model: Any) -> None:
    """Recompute MuJoCo's constants, and restore the placement of the hoist."""
    placements = model.eq_data.copy()
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.eq_data[:] = placements


def _movable_floor(plant: Plant) -> Any:
    """Return the floor's geom without MuJoCo's shortcut for geoms at the world's origin."""
    floor = plant.model.geom(FLOOR)
    plant.model.geom_sameframe[floor.id] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return floor
