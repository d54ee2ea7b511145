"""Geoms of contacts, and forces on them."""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings
from wbc_controller.simulation.mechanism import ON_THE_FLOOR, geom_names

_FAR = 1.0e3  # distance beyond any geom, m


class ContactForces:
    """Geoms of a robot in MuJoCo by contact.

    A force belongs to the nearest contact of its body. Contacts with another link have their own geoms.
    """

    def __init__(self, model: Any, contacts: Mapping[str, ContactSettings], bodies: Mapping[str, int]) -> None:
        self._model = model
        #: Geoms of floor and terrain.
        self.ground = [int(geom) for geom in np.flatnonzero(model.geom_contype & ON_THE_FLOOR)]
        #: Geoms that can touch the ground.
        self.on_the_floor = [int(geom) for geom in np.flatnonzero(model.geom_conaffinity & ON_THE_FLOOR)]
        self.geoms = {
            name: [geom for geom in self.on_the_floor if model.geom_bodyid[geom] == bodies[name]]
            if contact.against is None
            else [int(model.geom(geom).id) for geom in geom_names(name, contacts)]
            for name, contact in contacts.items()
        }
        self._contacts: dict[int, list[str]] = {}
        for name, geoms in self.geoms.items():
            for geom in geoms:
                self._contacts.setdefault(geom, []).append(name)

    def forces(self, data: Any, frames: Mapping[str, pin.SE3]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return force and moment of each contact about its origin in world axes, (3,) each, by name."""
        force = {name: np.zeros(3) for name in frames}
        moment = {name: np.zeros(3) for name in frames}
        local = np.zeros(6)
        for index in range(data.ncon):
            touch = data.contact[index]
            for geom, sign in zip(touch.geom, (-1.0, 1.0), strict=True):
                names = self._contacts.get(int(geom))
                if names is None:
                    continue
                name = min(names, key=lambda name: float(np.linalg.norm(touch.pos - frames[name].translation)))
                mujoco.mj_contactForce(self._model, data, index, local)
                # The rows of MuJoCo's contact frame are its axes, normal first; the force acts on the second geom.
                at_point = sign * touch.frame.reshape(3, 3).T @ local[:3]
                force[name] += at_point
                moment[name] += cross(touch.pos - frames[name].translation, at_point)
        return force, moment

    def bodies_without_contact(self, data: Any) -> frozenset[int]:
        """Return the bodies that touch the floor without a contact."""
        geoms = (int(geom) for touch in data.contact for geom in touch.geom)
        known = {*self.ground, *self._contacts}
        return frozenset(int(self._model.geom_bodyid[geom]) for geom in geoms if geom not in known)

    def distance(self, data: Any, geoms: Iterable[int]) -> float:
        """Return the smallest distance of geoms from the ground, m, negative inside; inf without geoms."""
        closest = _FAR
        for geom in geoms:
            for ground in self.ground:
                closest = min(closest, mujoco.mj_geomDistance(self._model, data, ground, geom, closest, None))
        return closest if closest < _FAR else float("inf")
