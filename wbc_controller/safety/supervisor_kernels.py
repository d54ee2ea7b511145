"""Kernel of `safety.supervisor`."""

from wbc_controller.compilation import Indices, Matrix, OutVector, StridedVector, Struct, Vector, compiled
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import clipped


class CommandLimits(Struct):
    """Limits of commands."""

    limits: Vector  # effort limits, (na,) in N·m
    rate: Vector  # torque rate limits, (na,) in N·m/s
    available: Matrix  # lower and upper available torques, (2, na) in N·m
    tolerance: float  # share of an effort limit by which a solution may exceed `available`
    q_index: Indices  # of the joints, (nj,)
    v_index: Indices  # (nj,)
    period: float  # control period T, s


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
    """Write the command of a solution; return False if its torques are NaN or exceed `available` and the tolerance.

    Args:
        tau: torques of the solution, (na,) in N·m; v_dot is its acceleration, (nv,).
        before: previous torques, (na,), with the weight `kept` in the new ones.
        share: share of the solution's torques to send.
        dt: time step of the rate limit, s.
        out: torques, (na,); joint positions q + T (v + T v̇) and velocities a period ahead, (nj,) each.
    """
    na, nj = len(command.limits), len(command.q_index)
    if not (len(tau) == len(before) == na and len(out) == na + 2 * nj and len(v_dot) == len(v)):
        raise ValueError("follow: tau and before must have size na, v_dot size nv, out size na + 2 nj")
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
            raise IndexError("follow: a joint index exceeds the size of q or v")
        velocity = v[column] + command.period * v_dot[column]
        out[na + i] = q[row] + command.period * velocity
        out[na + nj + i] = velocity
    return True
