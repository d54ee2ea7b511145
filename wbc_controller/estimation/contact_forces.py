"""Which contacts carry nothing, from torques and motion alone: the momentum observer of robot arms on legs.

The program predicts an acceleration from the torques sent and the contact forces f that it has chosen. Where a contact
does not carry, its point accelerates against the prediction. What of the missed change of momentum contacts take up is
the impulse of the forces that they lack (De Luca, Mattone, "Sensorless robot collision detection and hybrid
force/motion control", ICRA 2005, with contacts as the places of collision):

    Δf = (J M⁻¹ Jᵀ)⁻¹ J (v̇_measured - v̇_predicted),      f_measured = f + Δf

A contact that holds moves as predicted whatever the torques are worth, so that friction and weak motors count for
nothing here.
"""

from __future__ import annotations

from collections.abc import Mapping

from wbc_controller.records import Array

#: Time constant of the filter on the forces, s: short, as they are means of 10 ms already.
_FILTERED = 0.003


class ContactForces:
    """The normal forces of contacts that can only push.

    Attributes:
        lifted: names of the contacts that carry nothing, and should.
    """

    MEMORY = ("lifted", "_forces")

    def __init__(self, normals: Mapping[str, int], on: float, off: float) -> None:
        """Begin with nothing known.

        Args:
            normals: place of the normal force among the forces of each contact that can only push.
            on: force above which a contact carries that did not, N.
            off: force below which one does not that did, N; at most `on`.
        """
        self._normals, self._on, self._off = normals, on, off
        self.restart()

    def restart(self) -> None:
        """Forget all."""
        self.lifted: tuple[str, ...] = ()
        self._forces: dict[str, float] = {}

    def look(self, predicted: Mapping[str, Array], missed: Array, span: float) -> None:
        """Take what came of predictions over a span of time.

        Args:
            predicted: forces of the program, by contact, in N, N·m.
            missed: what they lacked, Δf, stacked in the same order.
            span: duration, s.
        """
        share, start, lifted = span / (_FILTERED + span), 0, set(self.lifted)
        forces: dict[str, float] = {}
        for name, force in predicted.items():
            place = self._normals.get(name)
            if place is not None:
                present = force.item(place) + missed.item(start + place)
                before = self._forces.get(name, force.item(place))
                forces[name] = now = before + share * (present - before)
                if now < self._off and force.item(place) > self._on:  # else it is the program that lets go of it
                    lifted.add(name)
                elif now > self._on:
                    lifted.discard(name)
            start += len(force)
        self._forces = forces
        self.lifted = tuple(name for name in forces if name in lifted)
