"""Motion of links: twists, their rates at v̇ = 0, momentum, Jacobians, and the rows of tasks and contacts on them.

A twist is [linear, angular]. At the world's origin and in world axes it is the same for all that is fixed to the link;
at a point p its linear part is v₀ + ω × p. So it is with the spatial acceleration, whose linear part at p lacks
ω × v(p) to be that of the point, and with the columns of a Jacobian: Pinocchio's, where the joint moves the link.

Placements are those of `placements`.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_VECTOR,
    INTEGER,
    ROWS,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    compile_all,
    compiled,
    indices,
    matrix,
    part,
    signs,
    vector,
)
from wbc_controller.inverse_dynamics.robot.placement_kernels import cross, place, quaternion, turn, turn_back
from wbc_controller.records import Array

#: Kinds of instructions of `fill_rows`: tasks on a frame, on the centre of mass and on single joints, contacts of a
#: surface and of a ball, and the rate of the momentum.
FRAME, COM, JOINTS, SURFACE, BALL, MOMENTUM = range(6)


@compiled(TABLE, VECTOR)
def link_terms(table: np.ndarray, velocity: Array) -> None:
    """Motion of each link at the world's origin, and of the centre of mass, by the recursive Newton-Euler algorithm.

    With v̇ = 0 and gravity as an acceleration of everything upwards, it gives a - g in place of a, and for the first
    link of each tree the wrench F, N that moves the whole tree: Σ m (a - g) and its moment. So the rate of the momentum
    about the centre of mass c is F + m g and N - c × F.

    Args:
        table: n, the number of links with the world, and r, of those on the world; and, in this order,
            joints: placements in the world, (n, 12).
            v: twists in the links' own axes, (n, 6).
            a: spatial accelerations at v̇ = 0 less gravity, likewise, (n, 6).
            f: wrenches from the link before, with all that the links behind need, likewise, (n, 6).
            roots: the links on the world, (r,).
            gravity: g in m/s², and m of all links in kg, (4,).
            com: c, (3,) in m.
            centroidal: A_Gᵀ, (nv, 6).
            links: for the twists and accelerations, (n, 12).
            per_mass: for A_Gᵀ / m, (nv, 6).
            com_velocity: for ċ, (3,) in m/s.
            com_drift: for c̈ at v̇ = 0, (3,) in m/s².
            drift: for the rate of the momentum at v̇ = 0, (6,) in N and N·m.
        velocity: generalized velocity, (nv,).
    """
    n, nv = table[0], len(velocity)
    joints, v, a, f = matrix(table, 2, n, 12), matrix(table, 3, n, 6), matrix(table, 4, n, 6), matrix(table, 5, n, 6)
    roots, gravity, com = indices(table, 6, table[1]), vector(table, 7, 4), vector(table, 8, 3)
    centroidal, links, per_mass = matrix(table, 9, nv, 6), matrix(table, 10, n, 12), matrix(table, 11, nv, 6)
    com_velocity, com_drift, drift = vector(table, 12, 3), vector(table, 13, 3), vector(table, 14, 6)
    mass = gravity[3]
    for i in range(1, len(joints)):
        R = joints[i]
        for half in range(2):
            local = v[i] if half == 0 else a[i]
            x, y, z = turn(R, local[0], local[1], local[2])
            wx, wy, wz = turn(R, local[3], local[4], local[5])
            cx, cy, cz = cross(wx, wy, wz, R[9], R[10], R[11])
            to = links[i, 6 * half :]
            to[0], to[1], to[2], to[3], to[4], to[5] = x - cx, y - cy, z - cz, wx, wy, wz
        for k in range(3):
            links[i, 6 + k] += gravity[k]
    for k in range(6):
        drift[k] = 0.0
    for root in roots:
        R, local = joints[root], f[root]
        x, y, z = turn(R, local[0], local[1], local[2])
        nx, ny, nz = turn(R, local[3], local[4], local[5])
        cx, cy, cz = cross(R[9] - com[0], R[10] - com[1], R[11] - com[2], x, y, z)
        drift[0], drift[1], drift[2] = drift[0] + x, drift[1] + y, drift[2] + z
        drift[3], drift[4], drift[5] = drift[3] + nx + cx, drift[4] + ny + cy, drift[5] + nz + cz
    for k in range(3):
        drift[k] += mass * gravity[k]
        com_drift[k] = drift[k] / mass
        com_velocity[k] = 0.0
    for j in range(len(velocity)):
        for k in range(6):
            per_mass[j, k] = centroidal[j, k] / mass
        for k in range(3):
            com_velocity[k] += per_mass[j, k] * velocity[j]


@part
def _seen(C: Array, motion: Array, out: Array) -> None:
    """A motion at the world's origin as seen at the origin of a placement, along its axes: both (6,)."""
    cx, cy, cz = cross(motion[3], motion[4], motion[5], C[9], C[10], C[11])
    out[0], out[1], out[2] = turn_back(C, motion[0] + cx, motion[1] + cy, motion[2] + cz)
    out[3], out[4], out[5] = turn_back(C, motion[3], motion[4], motion[5])


@part
def _contact_rows(
    joints: Array, links: Array, twists: Array, moves: np.ndarray, link: int, other: int, mount: Array,
    rows: np.ndarray, out: Array,
) -> None:  # fmt: skip
    """Rows of the twist ν of a contact frame C as seen from another link B, in the axes of C: J v̇ = -ν̇ at v̇ = 0.

    With X the transform of a twist of B to C, ν = ν_C - X ν_B and ν̇ = ν̇_C - X ν̇_B + ν × (X ν_B) (`contacts.mount`).

    Args:
        joints: placements of the links in the world, (n, 12).
        links: motions at the world's origin, (n, 12), of `link_terms`.
        twists: joint Jacobians, column by column, (nv, 6).
        moves: 1 where a joint moves a link, (n, nv).
        link: index of the link of C.
        other: index of the link of B; 0 for the world.
        mount: placement of C on its link, (12,).
        rows: components of ν that are wanted, (r,).
        out: for J, and -ν̇ at v̇ = 0 in the last column, (r, …).
    """
    C, column, nu, carried, nu_dot = np.empty(12), np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    place(joints[link], mount, C)
    for j in range(len(twists)):
        sign = moves[link, j] - moves[other, j]
        if sign == 0:
            for i in range(len(rows)):
                out[i, j] = 0.0
            continue
        _seen(C, twists[j], column)
        for i in range(len(rows)):
            out[i, j] = sign * column[rows[i]]
    _seen(C, links[other, :6], carried)
    _seen(C, links[link, :6], nu)
    _seen(C, links[other, 6:], column)
    _seen(C, links[link, 6:], nu_dot)
    for i in range(6):
        nu[i] -= carried[i]
        nu_dot[i] -= column[i]
    a, b, c = nu[3], nu[4], nu[5]
    x, y, z = cross(a, b, c, carried[0], carried[1], carried[2])
    u, v, w = cross(nu[0], nu[1], nu[2], carried[3], carried[4], carried[5])
    nu_dot[0], nu_dot[1], nu_dot[2] = nu_dot[0] + x + u, nu_dot[1] + y + v, nu_dot[2] + z + w
    x, y, z = cross(a, b, c, carried[3], carried[4], carried[5])
    nu_dot[3], nu_dot[4], nu_dot[5] = nu_dot[3] + x, nu_dot[4] + y, nu_dot[5] + z
    right = out.shape[1] - 1
    for i in range(len(rows)):
        out[i, right] = -nu_dot[rows[i]]


@part
def _ball_rows(
    joints: Array, links: Array, twists: Array, moves: np.ndarray, link: int, numbers: Array, out: Array
) -> None:  # fmt: skip
    """Rows of the velocity of a ball's lowest point against the world, Eᵀ(ṗ + ω × r): J v̇ = -drift (`contacts.point`).

    The drift is Eᵀ(p̈ + ω̇ × r) at v̇ = 0: p turns with the link, r does not.

    Args:
        joints: placements of the links in the world, (n, 12).
        links: motions at the world's origin, (n, 12), of `link_terms`.
        twists: joint Jacobians, column by column, (nv, 6).
        moves: 1 where a joint moves a link, (n, nv).
        link: index of the ball's link.
        numbers: the centre on that link in m; r, to the lowest point in world axes, in m; Eᵀ by rows, (15,).
        out: for J, and the required J v̇ at J v = 0 in the last column, (3, …).
    """
    at, motion, axes = joints[link], links[link], numbers[6:]
    px, py, pz = turn(at, numbers[0], numbers[1], numbers[2])
    px, py, pz = px + at[9], py + at[10], pz + at[11]
    x, y, z = px + numbers[3], py + numbers[4], pz + numbers[5]
    for j in range(len(twists)):
        if moves[link, j] == 0:
            for i in range(3):
                out[i, j] = 0.0
            continue
        cx, cy, cz = cross(twists[j, 3], twists[j, 4], twists[j, 5], x, y, z)
        cx, cy, cz = cx + twists[j, 0], cy + twists[j, 1], cz + twists[j, 2]
        for i in range(3):
            out[i, j] = axes[3 * i] * cx + axes[3 * i + 1] * cy + axes[3 * i + 2] * cz
    vx, vy, vz = cross(motion[3], motion[4], motion[5], px, py, pz)
    ux, uy, uz = cross(motion[3], motion[4], motion[5], motion[0] + vx, motion[1] + vy, motion[2] + vz)
    cx, cy, cz = cross(motion[9], motion[10], motion[11], x, y, z)
    cx, cy, cz = motion[6] + cx + ux, motion[7] + cy + uy, motion[8] + cz + uz
    right = out.shape[1] - 1
    for i in range(3):
        out[i, right] = -(axes[3 * i] * cx + axes[3 * i + 1] * cy + axes[3 * i + 2] * cz)


@part
def _rotation_error(R: Array, reference: Array, out: Array) -> None:
    """R log(Rᵀ R_ref) = log(R_ref Rᵀ), (3,), from the rotation of a placement to a quaternion (x, y, z, w)."""
    q = np.empty(4)
    quaternion(R, q)
    x, y, z, w = reference[0], reference[1], reference[2], reference[3]
    # reference · conjugate of q, of any length
    cx, cy, cz = cross(x, y, z, q[0], q[1], q[2])
    ex, ey, ez = q[3] * x - w * q[0] - cx, q[3] * y - w * q[1] - cy, q[3] * z - w * q[2] - cz
    ew = w * q[3] + x * q[0] + y * q[1] + z * q[2]
    if ew < 0.0:
        ex, ey, ez, ew = -ex, -ey, -ez, -ew
    sine = math.sqrt(ex * ex + ey * ey + ez * ez)
    # The half angle over its sine; below this size their ratio is that of the tangent to rounding.
    share = 2.0 * math.atan2(sine, ew) / sine if sine > 1.0e-9 * ew else 2.0 / ew
    out[0], out[1], out[2] = share * ex, share * ey, share * ez


@part
def _frame_rows(
    joints: Array, links: Array, twists: Array, moves: np.ndarray, link: int, first: int, size: int, numbers: Array,
    rows: np.ndarray, out: Array, error: Array,
) -> None:  # fmt: skip
    """Rows of a task on a frame's position, orientation or both, in world axes: J v̇ = ẍ_ref + D (ẋ_ref - ẋ) + K e - J̇v.

    Args:
        joints: placements of the links in the world, (n, 12).
        links: motions at the world's origin, (n, 12), of `link_terms`.
        twists: joint Jacobians, column by column, (nv, 6).
        moves: 1 where a joint moves a link, (n, nv).
        link: index of the frame's link.
        first: first component of the frame's twist that the task is on: 0, or 3 for an orientation.
        size: number of these components: 3 or 6.
        numbers: placement of the frame on its link, (12,); K and D, (size,) each; then the reference: position in m,
            quaternion, or both, and ẋ_ref and ẍ_ref, (size,) each.
        rows: components of the task that its mask selects, (r,).
        out: for J, and the right-hand sides in the last column, (r, …).
        error: for the task error, (r,) in m and rad.
    """
    at = np.empty(12)
    place(joints[link], numbers, at)
    px, py, pz = at[9], at[10], at[11]
    for j in range(len(twists)):
        if moves[link, j] == 0:
            for i in range(len(rows)):
                out[i, j] = 0.0
            continue
        cx, cy, cz = cross(twists[j, 3], twists[j, 4], twists[j, 5], px, py, pz)
        for i in range(len(rows)):
            row = first + rows[i]
            out[i, j] = twists[j, row] + (cx if row == 0 else cy if row == 1 else cz if row == 2 else 0.0)
    twist, drift, wanted = np.empty(6), np.empty(6), np.empty(6)
    motion = links[link]
    cx, cy, cz = cross(motion[3], motion[4], motion[5], px, py, pz)
    twist[0], twist[1], twist[2] = motion[0] + cx, motion[1] + cy, motion[2] + cz
    twist[3], twist[4], twist[5] = motion[3], motion[4], motion[5]
    cx, cy, cz = cross(motion[9], motion[10], motion[11], px, py, pz)
    ux, uy, uz = cross(motion[3], motion[4], motion[5], twist[0], twist[1], twist[2])
    drift[0], drift[1], drift[2] = motion[6] + cx + ux, motion[7] + cy + uy, motion[8] + cz + uz
    drift[3], drift[4], drift[5] = motion[9], motion[10], motion[11]
    end = 12 + 2 * size  # of the gains
    position, oriented = numbers[end:], first + size > 3
    length = (3 if first == 0 else 0) + (4 if oriented else 0)
    if first == 0:
        wanted[0], wanted[1], wanted[2] = position[0] - px, position[1] - py, position[2] - pz
    if oriented:
        _rotation_error(at, position[length - 4 :], wanted[3:])
    velocity, right = position[length:], out.shape[1] - 1
    for i in range(len(rows)):
        axis = rows[i]
        row = first + axis
        error[i] = wanted[row]
        out[i, right] = (
            numbers[12 + axis] * wanted[row]
            + numbers[12 + size + axis] * (velocity[axis] - twist[row])
            + velocity[size + axis]
            - drift[row]
        )


@part
def _com_rows(
    com: Array, com_velocity: Array, com_drift: Array, per_mass: Array, numbers: Array, rows: np.ndarray, out: Array,
    error: Array,
) -> None:  # fmt: skip
    """Rows of a task on the centre of mass, with `numbers` K, D, position, velocity and acceleration, (3,) each."""
    right = out.shape[1] - 1
    for i in range(len(rows)):
        k = rows[i]
        for j in range(len(per_mass)):
            out[i, j] = per_mass[j, k]
        error[i] = numbers[6 + k] - com[k]
        asked = numbers[k] * error[i] + numbers[3 + k] * (numbers[9 + k] - com_velocity[k])
        out[i, right] = asked + numbers[12 + k] - com_drift[k]


@part
def _joint_targets(
    q: Array, v: Array, numbers: Array, places: np.ndarray, count: int, minus_target: Array, error: Array
) -> float:  # fmt: skip
    """Targets of single accelerations of joints, from their positions (`tasks.posture`, `program.cost`).

    Args:
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        numbers: K, D, reference position, velocity and acceleration, then the negative factor from the desired
            acceleration to the target, and from its square to twice the constant, (count,) each.
        places: index in q of each joint, then that in v, (2 count,).
        count: number of joints.
        minus_target: for the negative targets, by index in v.
        error: for the task error, (count,).

    Returns:
        The cost that no acceleration avoids.
    """
    rest = 0.0
    for i in range(count):
        column = places[count + i]
        if not (0 <= places[i] < len(q) and 0 <= column < len(v)):
            raise IndexError("the index of a joint is not below the size of q or v")
        error[i] = numbers[2 * count + i] - q[places[i]]
        asked = numbers[i] * error[i] + numbers[count + i] * (numbers[3 * count + i] - v[column])
        asked += numbers[4 * count + i]
        minus_target[column] = numbers[5 * count + i] * asked
        rest += 0.5 * numbers[6 * count + i] * asked * asked
    return rest


@compiled(ANY_VECTOR, ANY_VECTOR, ANY_VECTOR, INTEGER, VECTOR_OUT)
def take_reference(position: Array, velocity: Array, acceleration: Array, size: int, wanted: Array) -> bool:
    """Put a reference where `fill_rows` reads it.

    Args:
        position: in the form of its task, (length,).
        velocity: (size,).
        acceleration: (size,).
        size: number of the task's components.
        wanted: the three of them, one after the other, (length + 2 size,).

    Returns:
        Whether they have these sizes; otherwise nothing is taken.
    """
    length = len(wanted) - 2 * size
    if len(position) != length or len(velocity) != size or len(acceleration) != size:
        return False
    for i in range(length):
        wanted[i] = position[i]
    for i in range(size):
        wanted[length + i], wanted[length + size + i] = velocity[i], acceleration[i]
    return True


@compiled(TABLE, VECTOR, VECTOR, VECTOR_OUT)
def fill_rows(table: np.ndarray, q: Array, v: Array, errors: Array) -> float:
    """The rows of all contacts and tasks of a program, by instructions (`formulation.rows`).

    Args:
        table: the number of instructions k, of places, of numbers, of links n, of rows and of columns of `out`; and,
            in this order,
            instructions: kind, first row in `out`, number of rows, link, other link, first component, size, and where
                its part of `places`, `numbers` and `errors` begins, (k, 10).
            places: rows that masks select, and indices of joints.
            numbers: constants, gains and references, as the functions above take them.
            joints: placements of the links in the world, (n, 12).
            links: motions at the world's origin, (n, 12), of `link_terms`.
            twists: joint Jacobians, column by column, (nv, 6).
            moves: 1 where a joint moves a link, (n, nv).
            com: position of the centre of mass, (3,) in m.
            com_velocity: its velocity, (3,) in m/s.
            com_drift: its acceleration at v̇ = 0, (3,) in m/s².
            per_mass: its Jacobian in the first three columns, (nv, 6).
            centroidal: A_Gᵀ, (nv, 6).
            drift: rate of the momentum about the centre of mass at v̇ = 0, (6,) in N and N·m.
            out: rows of the program, with the right-hand sides in the last column; columns beyond nv stay.
            minus_target: for the negative targets of single accelerations, (columns of `out`,).
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        errors: for the task errors.

    Returns:
        The cost that no acceleration avoids, of the tasks on single accelerations.
    """
    n, nv, columns = table[3], len(v), table[5]
    instructions, places = indices(table, 6, 10 * table[0]), indices(table, 7, table[1])
    numbers, joints, links = vector(table, 8, table[2]), matrix(table, 9, n, 12), matrix(table, 10, n, 12)
    twists, moves = matrix(table, 11, nv, 6), signs(table, 12, n, nv)
    com, com_velocity, com_drift = vector(table, 13, 3), vector(table, 14, 3), vector(table, 15, 3)
    per_mass, centroidal, drift = matrix(table, 16, nv, 6), matrix(table, 17, nv, 6), vector(table, 18, 6)
    block, minus_target = matrix(table, 19, table[4], columns), vector(table, 20, columns)
    rest = 0.0
    for k in range(table[0]):
        step = instructions[10 * k :]
        kind, row, count, link, other, first, size = step[0], step[1], step[2], step[3], step[4], step[5], step[6]
        rows, own = places[step[7] : step[7] + count], numbers[step[8] :]
        to, error = block[row : row + count], errors[step[9] :]
        if kind == FRAME:
            _frame_rows(joints, links, twists, moves, link, first, size, own, rows, to, error)
        elif kind == COM:
            _com_rows(com, com_velocity, com_drift, per_mass, own, rows, to, error)
        elif kind == JOINTS:
            rest += _joint_targets(q, v, own, places[step[7] :], size, minus_target, error)
        elif kind == SURFACE:
            _contact_rows(joints, links, twists, moves, link, other, own, rows, to)
        elif kind == BALL:
            _ball_rows(joints, links, twists, moves, link, own, to)
        elif kind == MOMENTUM:
            for i in range(6):
                for j in range(nv):
                    to[i, j] = centroidal[j, i]
                to[i, columns - 1] = -drift[i]
    return rest


@compiled(ANY_VECTOR, ANY_VECTOR, ANY_VECTOR, ROWS, ANY_VECTOR, ANY_VECTOR, VECTOR_OUT)
def feedback(
    error: Array, velocity: Array, drift: Array, gains: Array, velocity_wanted: Array, acceleration_wanted: Array,
    right: Array,
) -> None:  # fmt: skip
    """The law of `MotionTask`: ẍ_ref + D (ẋ_ref - ẋ) + K e - J̇v.

    Args:
        error: e, (size,).
        velocity: ẋ, (size,).
        drift: J̇v, (size,); (0,) where it is zero.
        gains: K and D, (2, size).
        velocity_wanted: ẋ_ref, (size,).
        acceleration_wanted: ẍ_ref, (size,).
        right: for the result, (size,).
    """
    size = len(error)
    if not (len(velocity) == size and (len(drift) == size or len(drift) == 0) and len(right) == size):
        raise ValueError("feedback: error, velocity, drift and right have sizes that do not agree")
    if not (gains.shape[0] == 2 and gains.shape[1] == size):
        raise ValueError("feedback: the gains have another size than the error")
    if not (len(velocity_wanted) == size and len(acceleration_wanted) == size):
        raise ValueError("feedback: velocity or acceleration of the reference has another size than the error")
    for i in range(size):
        right[i] = gains[0, i] * error[i] + gains[1, i] * (velocity_wanted[i] - velocity[i]) + acceleration_wanted[i]
        if len(drift):
            right[i] -= drift[i]


compile_all()
