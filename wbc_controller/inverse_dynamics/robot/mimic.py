"""Joints that follow others by ``<mimic>``, as the URDF says.

Pinocchio 4.1 has mimic joints, but most of its algorithms refuse them, including `computeAllTerms`. Here these joints
keep their own coordinates, and the coupling is a constraint whose force is eliminated from the equations of motion
together with the torques (`Actuation`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Mimic:
    """The law by which a joint follows another: q = ratio · q_leader + offset.

    Attributes:
        leader: the joint that it follows, which follows no other joint itself.
        ratio: dimensionless.
        offset: rad.
    """

    leader: str
    ratio: float
    offset: float


def read_mimics(tree: ElementTree.Element) -> dict[str, Mimic]:
    """Find the joints of a URDF, read by `parse_urdf`, that follow others, by name.

    Chains of followers are resolved to the joint at their end.

    Raises:
        ConfigurationError: if a joint follows a joint that the URDF does not have, or follows itself.
    """
    given: dict[str, Mimic] = {}
    names = [str(joint.get("name")) for joint in tree.findall("joint")]
    for joint in tree.findall("joint"):
        element = joint.find("mimic")
        if element is None or joint.get("type") == "fixed":
            continue
        name, leader = str(joint.get("name")), str(element.get("joint"))
        if leader not in names:
            raise ConfigurationError(
                f"robot.urdf: joint {name!r} mimics {leader!r}, which is no joint; {valid_choices(leader, names)}"
            )
        given[name] = Mimic(leader, float(element.get("multiplier", "1")), float(element.get("offset", "0")))
    found = {}
    for name, mimic in given.items():
        seen = [name]
        while mimic.leader in given:
            if mimic.leader in seen:
                raise ConfigurationError(f"robot.urdf: the joints {', '.join(seen)} mimic each other in a circle")
            seen.append(mimic.leader)
            above = given[mimic.leader]
            mimic = Mimic(above.leader, mimic.ratio * above.ratio, mimic.ratio * above.offset + mimic.offset)
        found[name] = mimic
    return found


class Followers:
    """The joints of a model that follow others.

    Attributes:
        names: their names, (nm,).
        mimics: the law of each follower, by name.
        q_index: index in q of each, (nm,).
        v_index: index in v of each, (nm,).
    """

    def __init__(self, mimics: Mapping[str, Mimic], q_index: Mapping[str, int], v_index: Mapping[str, int]) -> None:
        """Collect the followers from their laws, and the indices in q and v of all followers and leaders, by name."""
        self.names = tuple(mimics)
        self.mimics = dict(mimics)
        self.q_index = _picked(q_index, self.names)
        self.v_index = _picked(v_index, self.names)
        leaders = [mimic.leader for mimic in mimics.values()]
        self._q_leader, self._v_leader = _picked(q_index, leaders), _picked(v_index, leaders)
        self._ratio = np.array([mimic.ratio for mimic in mimics.values()])
        self._offset = np.array([mimic.offset for mimic in mimics.values()])

    def __len__(self) -> int:
        return len(self.names)

    def place(self, q: Array) -> None:
        """Write the positions of the followers into a configuration, (nq,)."""
        q[self.q_index] = self._ratio * q[self._q_leader] + self._offset

    def move(self, v: Array) -> None:
        """Write the velocities of the followers into a generalized velocity, or an acceleration, (nv,)."""
        v[self.v_index] = self._ratio * v[self._v_leader]

    def coupling(self, nv: int) -> Array:
        """The coupling matrix C, (nm, nv), with C v = 0."""
        C = np.zeros((len(self), nv))
        rows = np.arange(len(self))
        C[rows, self.v_index] = 1.0
        C[rows, self._v_leader] = -self._ratio
        return C

    def carry(self, force: Array) -> None:
        """Add the generalized forces on the followers to those on their leaders, by virtual work, in place, (nv,)."""
        np.add.at(force, self._v_leader, self._ratio * force[self.v_index])


def _picked(index: Mapping[str, int], names: Sequence[str]) -> np.ndarray:
    return np.array([index[name] for name in names], dtype=np.intp)
