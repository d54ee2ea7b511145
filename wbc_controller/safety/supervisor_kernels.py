"""The command that follows a solution (`safety.supervisor`)."""

from wbc_controller.compilation import Indices, Matrix, OutVector, StridedVector, Struct, Vector, compiled
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import clipped


class CommandLimits(Struct):
    """Limits of commands.

    Attributes:
        limits: effort limits, (na,) in N·m.
        rate: torque rate limit, (na,) in N·m/s.
        available: least and largest available torques, (2, na) in N·m.
        tolerance: share of an effort limit by which a solution may exceed the available torques.
        q_index: index in q of each joint, (nj,).
        v_index: index in v of each joint, (nj,).
        period: time between cycles, s.
    """

    limits: Vector
    rate: Vector
    available: Matrix
    tolerance: float
    q_index: Indices
    v_index: Indices
    period: float


@compiled
def follow(
    command: CommandLimits,
    tau: StridedVector,
    v_dot: StridedVector,
    q: StridedVector,
    v: StridedVector,
    before: Vector,
    share: float,
    kept: float,
    dt: float,
    out: OutVector,
) -> bool:
    """Write the command that follows a solution, if its torques are usable: available within a tolerance, and not NaN.

    Args:
        tau: torques of the solution, (na,) in N·m.
        v_dot: its generalized acceleration v̇, (nv,).
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        before: torques sent before, (na,) in N·m.
        share: share of the solution's torques that is sent.
        kept: share of the torques before in those sent.
        dt: time for which the torque rate limit counts, s.
        out: the torques, (na,) in N·m; the joint positions a period T ahead, q + T (v + T v̇), and velocities, (nj,)
            each.

    Returns:
        True if the torques are usable; otherwise nothing in `out` counts.
    """
    na, nj = len(command.limits), len(command.q_index)
    if not (len(tau) == len(before) == na and len(out) == na + 2 * nj and len(v_dot) == len(v)):
        raise ValueError("follow: torques, accelerations or command have another size than actuators and joints")
    for i in range(na):
        lower, upper = command.available[0, i], command.available[1, i]
        excess = command.tolerance * command.limits[i]
        if not (tau[i] >= lower - excess and tau[i] <= upper + excess):
            return False
        wanted = kept * before[i] + (1.0 - kept) * (share * tau[i]) if kept != 0.0 else share * tau[i]
        step = dt * command.rate[i]
        out[i] = clipped(clipped(wanted, before[i] - step, before[i] + step), lower, upper)
    for i in range(nj):
        row, column = command.q_index[i], command.v_index[i]
        if not (0 <= row < len(q) and 0 <= column < len(v)):
            raise IndexError("the index of a joint is not below the size of q or v")
        velocity = v[column] + command.period * v_dot[column]
        out[na + i] = q[row] + command.period * velocity
        out[na + nj + i] = velocity
    return True
