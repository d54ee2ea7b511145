"""Unloaded contacts, detected from torques and motion alone: the momentum observer of robot arms, applied to legs.

The QP predicts an acceleration from the torques sent and its contact forces f. If a contact carries no load, its point
accelerates against the prediction. The contacts' part of the unpredicted change of momentum is the impulse of their
missing forces (De Luca, Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005,
with contacts as the places of collision):

    Δf = (J M⁻¹ Jᵀ)⁻¹ J (v̇_measured - v̇_predicted),      f_measured = f + Δf

A contact at rest moves as predicted whatever the torques are, so friction and weak motors have no effect here.
"""

from __future__ import annotations

from collections.abc import Mapping

from wbc_controller.records import Array

#: Time constant of the filter on the forces, s. It is short because the forces are means over 10 ms.
_FILTER_TIME = 0.003


class ContactForces:
    """Filtered normal forces of unilateral contacts.

    Attributes:
        unloaded: names of the contacts that should carry load and do not.
    """

    STATE_FIELDS = ("unloaded", "_forces")

    def __init__(self, normals: Mapping[str, int], on: float, off: float) -> None:
        """Start without forces.

        Args:
            normals: index of the normal force in the wrench of each unilateral contact.
            on: force above which an unloaded contact counts as loaded, N.
            off: force below which a loaded contact counts as unloaded, N; at most `on`.
        """
        self._normals, self._on, self._off = normals, on, off
        self.restart()

    def restart(self) -> None:
        """Forget all forces."""
        self.unloaded: tuple[str, ...] = ()
        self._forces: dict[str, float] = {}

    def update(self, predicted: Mapping[str, Array], missing: Array, span: float) -> None:
        """Filter the forces of a time span.

        Args:
            predicted: forces of the QP, by contact, in N and N·m.
            missing: Δf, stacked in the same order.
            span: duration, s.
        """
        gain, start, unloaded = span / (_FILTER_TIME + span), 0, set(self.unloaded)
        forces: dict[str, float] = {}
        for name, force in predicted.items():
            index = self._normals.get(name)
            if index is not None:
                measured = force.item(index) + missing.item(start + index)
                before = self._forces.get(name, force.item(index))
                forces[name] = filtered = before + gain * (measured - before)
                if filtered < self._off and force.item(index) > self._on:  # below it, the QP itself unloads the contact
                    unloaded.add(name)
                elif filtered > self._on:
                    unloaded.discard(name)
            start += len(force)
        self._forces = forces
        self.unloaded = tuple(name for name in forces if name in unloaded)
