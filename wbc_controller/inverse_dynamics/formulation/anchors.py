"""Position feedback of contacts towards their anchors (`contacts.AnchoredContact`)."""

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError, MethodError
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.inverse_dynamics.contacts import AnchoredContact
from wbc_controller.inverse_dynamics.method_calls import checked, is_finite, raised, require_finite_result
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array

#: Regularization ε of J Jᵀ, in its units; small enough that its effect within the range of J is negligible.
_RIDGE = 1.0e-10


def pull(
    J: Array, anchored: Sequence[tuple[AnchoredContact, slice]], dynamics: Dynamics, anchors: Mapping[str, Array]
) -> Array:
    """Return K e of contacts with an anchor, 0 for the others, projected onto the range of J, (nf,) in m/s², rad/s².

    The equality constraints of all contacts have to be consistent; -D J v - J̇v always is. K e of contacts that are not
    independent, such as four points under one sole, is inconsistent to second order in e, and fully so if they were
    activated one after the other. So it is projected onto the range of J,

        J Jᵀ (J Jᵀ + ε 1)⁻¹ K e,    ε → 0

    which changes nothing if J has full row rank.

    Args:
        J: stacked Jacobians of the active contacts, (nf, nv).
        anchored: the contacts with a stiffness, and their rows of J.
        anchors: anchor of each active contact with a stiffness, (7,).

    Raises:
        ConfigurationError: if a contact with a stiffness has no anchor.
    """
    wanted = np.zeros(len(J))
    if not anchored:
        return wanted
    for contact, rows in anchored:
        anchor = anchors.get(contact.name)
        if anchor is None:
            raise ConfigurationError(
                f"contact {contact.name!r} has stiffness = {contact.stiffness:g} 1/s² and no anchor in the references "
                f"(they have: {', '.join(anchors) or 'none'}); `AnchoredContact.anchor` makes one"
            )
        wanted[rows] = contact.stiffness * _displacement(contact, dynamics, anchor)
    grams = J.dot(J.T)
    grams.reshape(-1)[:: len(J) + 1] += _RIDGE
    return np.asarray(J.dot(J.T.dot(solved(grams, wanted))))


def _displacement(contact: AnchoredContact, dynamics: Dynamics, anchor: Array) -> Array:
    """Call `AnchoredContact.displacement` and check its result."""
    try:
        displacement = checked(contact, "displacement", contact.displacement(dynamics, anchor), (contact.size,))
    except Exception as error:
        raise error if isinstance(error, MethodError) else raised(contact, "displacement", error) from error
    if not is_finite(displacement) and is_finite(anchor):
        require_finite_result(contact, "displacement", displacement)
    return displacement
