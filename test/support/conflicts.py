"""Conflicting constraints of a program before it is solved."""

from wbc_controller.inverse_dynamics.formulation.infeasibility import explain


def conflict_of(qp, state, references, before=None):
    """Return the conflict, including limits that `solve` would relax; None for a feasible program."""
    layout = qp.formulation.build(state, references, before)
    return explain(layout, qp.model, qp.formulation.effort_bounds(references))
