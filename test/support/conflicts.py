"""Conflicting constraints of a program, and programs with other bounds of the joint accelerations."""

from wbc_controller.inverse_dynamics.formulation.infeasibility import explain


def conflict_of(qp, state, references, before=None):
    """Return the conflict, including limits that `solve` would relax; None for a feasible program."""
    layout = qp.formulation.build(state, references, before)
    return explain(layout, qp.model, qp.formulation.effort_bounds(references))


def conflict_at_rest(robot, references=None):
    """Return the conflict of a robot without accelerations, the layout of its program, and its effort bounds."""
    references = references or robot.references()
    formulation = robot.controller.formulation
    layout, effort = formulation.build(robot.state(), references), formulation.effort_bounds(references)
    accelerations = slice(0, robot.model.nv)
    layout.problem.x_lower[accelerations] = layout.problem.x_upper[accelerations] = 0.0
    return explain(layout, robot.model, effort, held=("motion",)), layout, effort


def set_motion_bounds(robot, joints, lower, upper):
    """Set bounds of joint accelerations, rad/s², in every program that is built from now on."""
    formulation, columns = robot.controller.formulation, robot.model.v_index[joints]
    build = formulation.build

    def built(*arguments):
        layout = build(*arguments)
        layout.problem.x_lower[columns], layout.problem.x_upper[columns] = lower, upper
        return layout

    formulation.build = built
