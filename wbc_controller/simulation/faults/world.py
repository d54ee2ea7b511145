"""Faults of the world and of the model: the robot or its floor differs from the controller's model."""

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, NamedFault, Site, number, ramped
from wbc_controller.simulation.mechanism import FLOOR, position_and_wxyz
from wbc_controller.simulation.plant import Plant

#: Duration of a kick, s.
_KICK = 0.02
#: Largest penetration of a foot at which the floor comes back below it, m: at rest there is a little.
_AT_REST = 1.0e-3


class _WorldFault(Fault):
    place = "world and model"


class _LinkFault(NamedFault):
    place = "world and model"
    link: str = Field("", description="name of the URDF link; empty for the base")


class _FloorFault(NamedFault):
    """A fault of the floor, without effect on robots without contacts, which have none."""

    place = "world and model"

    def begin(self, site: Site) -> Effect:
        """Begin, and return the effect."""
        return self._begin(site) if site.plant.contacts else Effect()

    def _begin(self, site: Site) -> Effect:
        raise NotImplementedError


class Payload(_LinkFault):
    """A load is fastened to a link."""

    share: float = number(0.05, 0.005, 0.5, "", "of the robot's mass")

    def begin(self, site: Site) -> Effect:
        """Add the mass to the body of the link."""
        body = site.plant.body(self.link or site.robot.base_link)
        masses = np.zeros(site.plant.model.nbody)
        masses[body] = self.share * site.robot.mass
        return _heavier(site.plant, masses)


class MassError(_WorldFault):
    """All links are heavier or lighter than the model says; their inertias too."""

    share: float = number(0.1, -0.4, 0.4, "", "of each mass that is added")

    def begin(self, site: Site) -> Effect:
        """Add the masses."""
        return _heavier(site.plant, self.share * site.plant.model.body_mass)


class CenterOfMassError(_WorldFault):
    """The base's centre of mass is elsewhere than the model says."""

    offset: float = number(0.02, 0.002, 0.2, "m", "in a random horizontal direction")

    def begin(self, site: Site) -> Effect:
        """Shift the base's own centre of mass."""
        model, body = site.plant.model, site.plant.body(site.robot.base_link)
        before = model.body_ipos[body].copy()
        model.body_ipos[body] += self.offset * site.direction()
        model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # MuJoCo's short cut for no offset

        def ended() -> None:
            model.body_ipos[body] = before

        return Effect(ended=ended)


class SlipperyFloor(_FloorFault):
    """The floor is slippery, below all feet or one."""

    contact: str = Field("", description="name of the contact on it; empty for all")
    friction: float = number(0.1, 0.0, 0.5, "", "coefficient of the floor")

    def _begin(self, site: Site) -> Effect:
        """Change the friction of the floor, which has precedence over that of the feet; or give a foot precedence."""
        model = site.plant.model
        geoms = site.plant.contact_forces.geoms[self.contact] if self.contact else [model.geom(FLOOR).id]
        before = model.geom_friction[geoms, 0].copy(), model.geom_priority[geoms].copy()
        model.geom_friction[geoms, 0] = self.friction
        if self.contact:
            model.geom_priority[geoms] = model.geom_priority.max() + 1

        def ended() -> None:
            model.geom_friction[geoms, 0], model.geom_priority[geoms] = before

        return Effect(ended=ended)


class SoftFloor(_FloorFault):
    """The floor yields."""

    time_constant: float = number(0.05, 0.01, 0.2, "s", "with which feet come to rest in it")

    def _begin(self, site: Site) -> Effect:
        """Change the stiffness of the floor, which has precedence over that of the feet."""
        stiffness = site.plant.model.geom(FLOOR).solref
        before = float(stiffness[0])
        stiffness[0] = self.time_constant

        def ended() -> None:
            stiffness[0] = before

        return Effect(ended=ended)


class FloorDrop(_FloorFault):
    """The floor sinks at once, and stays there: the robot falls onto it."""

    depth: float = number(0.05, 0.002, 0.5, "m", "by which it sinks")

    def _begin(self, site: Site) -> Effect:
        """Lower the floor."""
        _movable_floor(site.plant).pos[2] -= self.depth
        return Effect()


class FloorHole(_FloorFault):
    """There is no floor below one foot; where it has sunk, it is free until it is above the floor again."""

    contact: str = Field("", description="name of the contact; empty for one at random")

    def _begin(self, site: Site) -> Effect:
        """Take away what the foot collides with."""
        model, names = site.plant.model, tuple(site.plant.contacts)
        foot = names[site.one_of(self.contact, names)]
        geoms = site.plant.contact_forces.geoms[foot]
        before = model.geom_conaffinity[geoms].copy()
        model.geom_conaffinity[geoms] = 0

        def ended() -> bool:
            above = site.plant.contact_forces.height(site.plant.data, geoms) >= -_AT_REST
            if above:
                model.geom_conaffinity[geoms] = before
            return above

        return Effect(ended=ended)


class FloorTilt(_FloorFault):
    """The floor tilts about a horizontal axis below the base, and stays tilted."""

    angle: float = number(0.05, 0.005, 0.4, "rad", "of the tilt")
    ramp: float = number(0.5, 0.1, 1.0, "s", "time in which it tilts")

    def _begin(self, site: Site) -> Effect:
        """Turn the floor a little in each period."""
        plant, floor = site.plant, _movable_floor(site.plant)
        rotation = rotation_of(floor.quat[[1, 2, 3, 0]])
        centre = np.array([*plant.state()[0][:2], 0.0])
        centre[2] = -float(rotation[:2, 2] @ (centre[:2] - floor.pos[:2])) / rotation[2, 2] + floor.pos[2]
        axis = site.direction()

        def tilt() -> None:
            turned = pin.SE3(pin.exp3(self.angle * ramped(site.passed, self.ramp) * axis) @ rotation, centre)
            placed = position_and_wxyz(turned)
            floor.pos[:], floor.quat[:] = placed[:3], placed[3:]

        return Effect(each_period=tilt)


class Push(_LinkFault):
    """A steady horizontal force on a link, for the whole duration."""

    share: float = number(0.1, 0.01, 1.0, "", "of the robot's weight, in a random direction")

    def begin(self, site: Site) -> Effect:
        """Push for the time that is left."""
        force = self.share * site.robot.mass * site.robot.gravity * site.direction()
        _push(site, self.link, force, max(site.end - site.plant.time, site.period))
        return Effect()


class Kick(_LinkFault):
    """A short blow on a link; the duration does not matter."""

    speed: float = number(0.2, 0.02, 2.0, "m/s", "the impulse per mass of the robot, in a random horizontal direction")

    def begin(self, site: Site) -> Effect:
        """Push for a short time."""
        _push(site, self.link, self.speed * site.robot.mass / _KICK * site.direction(), _KICK)
        return Effect()


def _push(site: Site, link: str, force: Array, duration: float) -> None:
    site.plant.push(link or site.robot.base_link, [*force.tolist(), 0.0, 0.0, 0.0], duration)


def _heavier(plant: Plant, masses: Array) -> Effect:
    """Add masses to the bodies, (nbody,) in kg, with inertias in proportion."""
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
    """Recompute what MuJoCo derives from masses; it does so in another state, and knows no placement of the hoist."""
    placements = model.eq_data.copy()
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.eq_data[:] = placements


def _movable_floor(plant: Plant) -> Any:
    """The floor's geom; MuJoCo has a short cut for one whose place is that of the world, which has to be taken away."""
    floor = plant.model.geom(FLOOR)
    plant.model.geom_sameframe[floor.id] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return floor


KINDS: tuple[type[Fault], ...] = (
    Payload, MassError, CenterOfMassError, SlipperyFloor, SoftFloor, FloorDrop, FloorHole, FloorTilt, Push, Kick,
)  # fmt: skip
