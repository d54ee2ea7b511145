"""Detection of unloaded contacts by the momentum observer.

The QP predicts an acceleration from the torques sent and its contact forces f. An unloaded contact deviates by its
missing force (De Luca, Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005):

    Δf = (J M⁻¹ Jᵀ)⁻¹ J (v̇_measured - v̇_predicted),      f_measured = f + Δf

Friction and weak motors have no effect: a contact at rest moves as predicted for any torques.
"""

from collections.abc import Mapping

from wbc_controller.records import Array

_FILTER_TIME = 0.003  # time constant of the force filter, s


class ContactForces:
    """Filtered normal forces of unilateral contacts; `unloaded` names contacts that should carry load and do not."""

    STATE_FIELDS = ("unloaded", "_forces")

    def __init__(self, normals: Mapping[str, int], on: float, off: float) -> None:
        """Start without forces; `normals` are indices in the wrenches, `on` and `off` the thresholds in N, off ≤ on."""
        self._normals, self._on, self._off = normals, on, off
        self.restart()

    def restart(self) -> None:
        """Reset."""
        self.unloaded: tuple[str, ...] = ()
        self._forces: dict[str, float] = {}

    def update(self, predicted: Mapping[str, Array], missing: Array, span: float) -> None:
        """Filter the QP's forces by contact, N and N·m, plus the stacked Δf, over a span, s."""
        gain, start, unloaded = span / (_FILTER_TIME + span), 0, set(self.unloaded)
        forces: dict[str, float] = {}
        for name, force in predicted.items():
            index = self._normals.get(name)
            if index is not None:
                measured = force.item(index) + missing.item(start + index)
                before = self._forces.get(name, force.item(index))
                forces[name] = filtered = before + gain * (measured - before)
                if filtered < self._off and force.item(index) > self._on:  # otherwise the QP unloads the contact
                    unloaded.add(name)
                elif filtered > self._on:
                    unloaded.discard(name)
            start += len(force)
        self._forces = forces
        self.unloaded = tuple(name for name in forces if name in unloaded)
