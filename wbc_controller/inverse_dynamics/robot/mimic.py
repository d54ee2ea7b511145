"""Mimic joints, which follow other joints.

They keep their coordinates; `Actuation` eliminates the coupling force. Most algorithms of Pinocchio 4.1 refuse them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Mimic:
    """Coupling of a mimic joint to its leader: q = ratio · q_leader + offset."""

    leader: str  # leading joint, no mimic joint itself
    ratio: float  # dimensionless
    offset: float  # rad


def read_mimics(tree: ElementTree.Element) -> dict[str, Mimic]:
    """Find the mimic joints of a checked URDF, by name; chains are resolved to their first leader."""
    given: dict[str, Mimic] = {}
    names = [str(joint.get("name")) for joint in tree.findall("joint")]
    for joint in tree.findall("joint"):
        element = joint.find("mimic")
        if element is None or joint.get("type") == "fixed":
            continue
        name, leader = str(joint.get("name")), str(element.get("joint"))
        require_known(leader, names, f"robot.urdf: joint {name!r} mimics the unknown joint")
        given[name] = Mimic(leader, float(element.get("multiplier", "1")), float(element.get("offset", "0")))
    found = {}
    for name, mimic in given.items():
        seen = [name]
        while mimic.leader in given:
            if mimic.leader in seen:
                raise ConfigurationError(f"robot.urdf: the joints {', '.join(seen)} mimic each other in a cycle")
            seen.append(mimic.leader)
            above = given[mimic.leader]
            mimic = Mimic(above.leader, mimic.ratio * above.ratio, mimic.ratio * above.offset + mimic.offset)
        found[name] = mimic
    return found


class Followers:
    """Mimic joints of a model."""

    def __init__(self, mimics: Mapping[str, Mimic], own: Sequence[np.ndarray], leaders: Sequence[np.ndarray]) -> None:
        self.names = tuple(mimics)  # (nm,)
        self.mimics = dict(mimics)  # by name
        self.q_index, self.v_index = own  # (nm,) each
        self._q_leader, self._v_leader = leaders
        self._ratio = np.array([mimic.ratio for mimic in mimics.values()])
        self._offset = np.array([mimic.offset for mimic in mimics.values()])

    def __len__(self) -> int:
        return len(self.names)

    def place(self, q: Array) -> None:
        """Write the positions of the mimic joints to a configuration (nq,)."""
        q[self.q_index] = self._ratio * q[self._q_leader] + self._offset

    def move(self, v: Array) -> None:
        """Write the velocities, or accelerations, of the mimic joints to a vector (nv,)."""
        v[self.v_index] = self._ratio * v[self._v_leader]

    def coupling(self, nv: int) -> Array:
        """Return the coupling matrix C, (nm, nv), with C v = 0."""
        C = np.zeros((len(self), nv))
        rows = np.arange(len(self))
        C[rows, self.v_index] = 1.0
        C[rows, self._v_leader] = -self._ratio
        return C

    def carry(self, force: Array) -> None:
        """Add the generalized forces (nv,) of mimic joints to their leaders, in place."""
        np.add.at(force, self._v_leader, self._ratio * force[self.v_index])
