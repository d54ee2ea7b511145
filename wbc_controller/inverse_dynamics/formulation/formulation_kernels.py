"""Kernel for the numbers of the quadratic program."""

from wbc_controller.compilation import OutVector, Struct, Vector, compiled
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import JointMotion, acceleration_bounds
from wbc_controller.inverse_dynamics.robot.dynamics_kernels import DynamicsRows, fill_dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import FrameRows, fill_rows
from wbc_controller.inverse_dynamics.robot.link_motion_kernels import link_terms


class Program(Struct):
    """Arrays of a quadratic program."""

    rows: FrameRows  # with the link motion
    dynamics: DynamicsRows  # and torque bounds
    motion_limit: JointMotion  # limits of the joint motion


@compiled
def fill_program(
    program: Program, q: Vector, v: Vector, h: Vector, tau_before: Vector, share: float, examined: Vector,
    errors: OutVector,
) -> tuple[float, float]:  # fmt: skip
    """Call `link_terms`, `fill_rows`, `fill_dynamics` and `acceleration_bounds`, with their arguments.

    Return the constant cost, and the largest joint motion since the configuration `examined`, (nq,).
    """
    if len(examined) != len(q):
        raise ValueError("fill_program: the sizes of q and the examined configuration differ")
    link_terms(program.rows.motion, v)
    constant = fill_rows(program.rows, q, v, errors)
    fill_dynamics(program.dynamics, h, v, tau_before, share)
    acceleration_bounds(program.motion_limit, q, v)
    moved = 0.0
    for index in program.motion_limit.q_index:
        motion = abs(q[index] - examined[index])
        if motion > moved or motion != motion:  # keeps NaN
            moved = motion
    return constant, moved
