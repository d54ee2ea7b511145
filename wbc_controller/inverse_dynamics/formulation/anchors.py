"""Position feedback of contacts towards their anchors (`contacts.AnchoredContact`)."""

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError, MethodError
from wbc_controller.inverse_dynamics.contacts import AnchoredContact
from wbc_controller.inverse_dynamics.method_calls import checked, is_finite, raised, require_finite_result
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array


def pull(
    rows: int, anchored: Sequence[tuple[AnchoredContact, slice]], dynamics: Dynamics, anchors: Mapping[str, Array]
) -> Array:
    """Return K e of contacts with an anchor, 0 for the others, (nf,) in m/s², rad/s².

    Contacts that are not independent, such as four points under one sole that were activated one after the other, may
    not be able to reach all anchors; `formulation.redundancy` finds the nearest acceleration.

    Args:
        rows: number of rows of all active contacts, nf.
        anchored: the contacts with a stiffness, and their rows of J.
        anchors: anchor of each active contact with a stiffness, (7,).

    Raises:
        ConfigurationError: if a contact with a stiffness has no anchor.
    """
    wanted = np.zeros(rows)
    for contact, own in anchored:
        anchor = anchors.get(contact.name)
        if anchor is None:
            raise ConfigurationError(
                f"contact {contact.name!r} has stiffness = {contact.stiffness:g} 1/s² and no anchor in the references "
                f"(they have: {', '.join(anchors) or 'none'}); `AnchoredContact.anchor` makes one"
            )
        wanted[own] = contact.stiffness * _displacement(contact, dynamics, anchor)
    return wanted


def _displacement(contact: AnchoredContact, dynamics: Dynamics, anchor: Array) -> Array:
    """Call `AnchoredContact.displacement` and check its result."""
    try:
        displacement = checked(contact, "displacement", contact.displacement(dynamics, anchor), (contact.size,))
    except Exception as error:
        raise error if isinstance(error, MethodError) else raised(contact, "displacement", error) from error
    if not is_finite(displacement) and is_finite(anchor):
        require_finite_result(contact, "displacement", displacement)
    return displacement
