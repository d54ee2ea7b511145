"""Reads the arrays of a sensor_msgs/JointState by joint name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.records import Array

_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}


class JointOrder:
    """Reads joint states by joint name, and caches the joint order of the last message.

    Attributes:
        index: where each of the robot's joints stands in the last message, (nj,).
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = tuple(joints)
        self._names: list[str] | None = None  # None before the first message, since a message's list may be empty
        self.index = np.zeros(0, dtype=np.intp)

    def read(self, content: Any) -> tuple[Array, Array]:
        """Read a sensor_msgs/JointState of a robot.

        Returns:
            Positions in rad and velocities in rad/s, both (nj,).

        Raises:
            InputRefused: if a joint is missing or named twice, an array has a wrong size, or a value is not finite.
        """
        position, velocity = self.columns(content, "position", "velocity")
        return position, velocity

    def columns(self, content: Any, *columns: str) -> list[Array]:
        """Read some arrays of a sensor_msgs/JointState: ``position``, ``velocity``, ``effort``.

        Returns:
            One array per column, (nj,) each, in rad, rad/s and N·m.

        Raises:
            InputRefused: as in `read`.
        """
        if content.name != self._names:
            self.index = self._find(content.name)
            self._names = content.name
        values = []
        for what in columns:
            array = getattr(content, what)
            if what == "velocity" and len(array) == 0 and len(content.name) > 0:
                raise InputRefused(
                    f"velocity has 0 values for {len(content.name)} names; for a robot that measures none, "
                    "estimation.joint_velocity has to be differentiated"
                )
            if len(array) != len(content.name):
                raise InputRefused(f"{what} has {len(array)} values for {len(content.name)} names")
            own = array[self.index]
            if not np.isfinite(own).all():
                i = int(np.flatnonzero(~np.isfinite(own))[0])
                raise InputRefused(
                    f"{what} of {self._joints[i]!r} is {own[i]} {_UNITS[what]}; every value must be finite"
                )
            values.append(own)
        return values

    def _find(self, names: Sequence[str]) -> Any:
        places = {name: i for i, name in enumerate(names)}
        if len(places) < len(names):
            no_duplicates(names)
        missing = [name for name in self._joints if name not in places]
        if missing:
            strange = [name for name in names if name not in self._joints]
            unknown = f"; names that are none of the controller's joints: {', '.join(strange)}" if strange else ""
            raise InputRefused(
                f"{len(missing)} of {len(self._joints)} joints are missing: {', '.join(missing)}{unknown}"
            )
        return np.array([places[name] for name in self._joints], dtype=np.intp)


def no_duplicates(names: Sequence[str]) -> None:
    """Raise `InputRefused` if a joint is named more than once."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise InputRefused(f"joint {twice[0]!r} stands more than once; every joint is named once")
