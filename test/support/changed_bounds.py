"""Programs with other bounds of the joint accelerations than their limits have."""


def change_motion_bounds(formulation, change):
    """Let a function of the lower and upper bounds of x change those of every program that is built from now on."""
    build = formulation.build

    def built(*arguments):
        layout = build(*arguments)
        change(layout.problem.x_lower, layout.problem.x_upper)
        return layout

    formulation.build = built
