"""Contact detection from sensors, else planned contacts; unloaded contacts by the momentum observer.

The QP predicts an acceleration from the torques sent and its contact forces f. An unloaded contact deviates by its
missing force (De Luca, Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005):

    Δf = (J M⁻¹ Jᵀ)⁻¹ J (v̇_measured - v̇_predicted),      f_measured = f + Δf

Friction and weak motors have no effect: a contact at rest moves as predicted for any torques.
"""

from collections.abc import Collection, Mapping

from wbc_controller.records import Array

_FILTER_TIME = 0.003  # time constant of the force filter, s


class ContactDetector:
    """Detector of active contacts: by fresh force, else by the last switch message, else as planned."""

    def __init__(self, normals: Mapping[str, Mapping[str, Array]], on: float, off: float, timeout: float) -> None:
        """Start without messages.

        `normals` are those of each contact, (3,), by the frame in which a force may be given. The normal force `on`
        activates a contact, and `off`, at most `on`, deactivates it, N; after the time `timeout`, s, a force is stale.
        """
        self.normals, self._on, self._off, self._timeout = normals, on, off, timeout
        self.silent: tuple[str, ...] = ()  # contacts with a stale force
        self.measured: Mapping[str, bool] = {}  # state of each contact with a switch or a fresh force
        self._by_force: dict[str, bool] = {}
        self._by_switch: dict[str, bool] = {}

    def update_force(self, contact: str, force: float) -> None:
        """Store the normal force at a contact, N; positive if it pushes the robot."""
        self._by_force[contact] = force > (self._off if self._by_force.get(contact) else self._on)

    def update_switch(self, contact: str, active: bool) -> None:
        """Store the state of a contact switch."""
        self._by_switch[contact] = active

    def forget_forces(self) -> None:
        """Reset the forces after a restart of the clock."""
        self._by_force.clear()
        self.silent = ()
        self.measured = dict(self._by_switch)

    def active(self, planned: Collection[str], ages: Mapping[str, float]) -> frozenset[str]:
        """Return the active contacts from the planned ones and the forces' ages, s."""
        fresh = {name: active for name, active in self._by_force.items() if ages[name] <= self._timeout}
        self.silent = tuple(name for name in self._by_force if name not in fresh)
        self.measured = measured = {**self._by_switch, **fresh}
        unmeasured = [name for name in planned if name not in measured]
        return frozenset(unmeasured + [name for name, active in measured.items() if active])

    def timeout_note(self, contact: str) -> str:
        """Return a sentence on the stale force at a contact."""
        return (
            f"no force message for more than {self._timeout:g} s (estimation.contact_timeout); "
            f"contact {contact!r} is active as commanded"
        )


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
