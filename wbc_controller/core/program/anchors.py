"""Contacts that go back to where they were made: the position feedback of `contacts.AnchoredContact`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbc_controller.core.arrays import solved
from wbc_controller.core.program.layout import Layout
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array

#: Added to J Jᵀ, in its units. The share of it that it takes from accelerations that J v̇ can be is not noticed.
_RIDGE = 1.0e-10


def pull(layout: Layout, dynamics: Dynamics, anchors: Mapping[str, Array]) -> Array:
    """K e of the contacts that have an anchor, and 0 of the others, as far as J v̇ can be it, (nf,) in m/s², rad/s².

    What contacts ask for has to be possible together: -D J v - J̇v always is. K e of contacts that are not independent,
    such as four points under one sole, is in conflict in the second order of e, and wholly where they were made one
    after the other. So it is projected to the range of J,

        J Jᵀ (J Jᵀ + ε 1)⁻¹ K e,    ε → 0

    which changes nothing where J has full rank.

    Args:
        layout: with the contacts' Jacobians filled.
        dynamics: the snapshot.
        anchors: of each contact that is made and has a stiffness, (7,).

    Raises:
        ConfigurationError: where one has no anchor.
    """
    J = layout.J
    wanted = np.zeros(len(J))
    for contact, rows in layout.anchored:
        anchor = anchors.get(contact.name)
        if anchor is None:
            raise ConfigurationError(
                f"contact {contact.name!r} has stiffness = {contact.stiffness:g} 1/s² and no anchor in the references "
                f"(they have: {', '.join(anchors) or 'none'}); `AnchoredContact.anchor` makes one"
            )
        wanted[rows] = contact.stiffness * contact.displacement(dynamics, anchor)
    grams = J.dot(J.T)
    grams.reshape(-1)[:: len(J) + 1] += _RIDGE
    return np.asarray(J.dot(J.T.dot(solved(grams, wanted))))
