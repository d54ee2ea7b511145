"""Position feedback of contacts to their anchors."""

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import AnchoredContact
from wbc_controller.inverse_dynamics.method_calls import call, checked, is_finite, require_finite_result
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array


def anchor_feedback(
    rows: int, anchored: Sequence[tuple[AnchoredContact, slice]], dynamics: Dynamics, anchors: Mapping[str, Array]
) -> Array:
    """Return K e, (nf,) in m/s² and rad/s²; raises `ConfigurationError` without an anchor.

    `rows` is nf; `anchored`: contacts with a stiffness, and their rows of J, with 0 for the others.
    """
    wanted = np.zeros(rows)
    for contact, own in anchored:
        anchor = anchors.get(contact.name)
        if anchor is None:
            raise ConfigurationError(
                f"contact {contact.name!r} has stiffness = {contact.stiffness:g} 1/s², but no anchor in the references "
                f"(anchors: {', '.join(anchors) or 'none'}); make one with `AnchoredContact.anchor`"
            )
        wanted[own] = contact.stiffness * _displacement(contact, dynamics, anchor)
    return wanted


def _displacement(contact: AnchoredContact, dynamics: Dynamics, anchor: Array) -> Array:
    displacement = checked(contact, "displacement", call(contact, "displacement", dynamics, anchor), (contact.size,))
    if not is_finite(displacement) and is_finite(anchor):
        require_finite_result(contact, "displacement", displacement)
    return displacement
