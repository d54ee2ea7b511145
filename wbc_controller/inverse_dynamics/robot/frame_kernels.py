"""Kernels for contact and task rows J v̇ = b."""

import math

import numpy as np

from wbc_controller.compilation import (
    IndexMatrix,
    Indices,
    OutMatrix,
    OutVector,
    Struct,
    Vector,
    compiled,
    copy,
    copy_rows,
    part,
)
from wbc_controller.inverse_dynamics.robot.link_motion_kernels import LinkMotion
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    Vector3,
    add,
    cross,
    dot,
    place,
    put,
    put_motion,
    quaternion,
    scale,
    subtract,
    three,
    to_frame,
    transform,
)
from wbc_controller.records import Array

#: Kinds of rows: tasks on frames, centre of mass and joints; surface and ball contacts; momentum rate.
FRAME, COM, JOINTS, SURFACE, BALL, MOMENTUM = range(6)
#: Columns of the instructions: kind; first row in `out`, number of rows; link, other link; first twist component,
#: number of components; first index in `places`, `numbers` and task errors.
KIND, ROW, COUNT, LINK, OTHER, FIRST, SIZE, PLACE, NUMBER, ERROR = range(10)


class FrameRows(Struct):
    """Rows of contacts and tasks, and instructions to fill them."""

    instructions: IndexMatrix  # see `KIND` to `ERROR`, (k, 10)
    places: Indices  # selected components, and indices of joints
    numbers: Vector  # constants, gains and references in the order of the functions below
    motion: LinkMotion  # of the links
    out: OutMatrix  # rows [J, …, b]; columns between J and b are not written
    target: OutVector  # targets of single accelerations by index in v, (≥ nv,)


@part
def _contact_rows(
    motion: LinkMotion, link: int, other: int, mount: Array, rows: Indices, out: Array, memory: Array
) -> None:
    """Fill rows of the twist ν of a contact frame C relative to link B, in the axes of C: J v̇ = -ν̇ at v̇ = 0.

    With X the transform of a twist from B to C, ν = ν_C - X ν_B and ν̇ = ν̇_C - X ν̇_B + ν × (X ν_B). `mount` is the
    placement of C on its link, `rows` (r,) selects components of ν.
    """
    C, column, right = memory[0], memory[1], out.shape[1] - 1
    twists, moves, links = motion.joint_twists, motion.moves, motion.links
    place(motion.joints[link], mount, C)
    for j in range(len(twists)):
        sign = moves[link, j] - moves[other, j]
        if sign == 0:
            out[:, j] = 0.0
        else:
            put_motion(column, to_frame(C, three(twists[j], 0), three(twists[j], 3)))
            for i in range(len(rows)):
                out[i, j] = sign * column[rows[i]]
    on_link, on_other = links[link], links[other]
    linear, angular = to_frame(C, three(on_other, 0), three(on_other, 3))  # X ν_B
    own_linear, own_angular = to_frame(C, three(on_link, 0), three(on_link, 3))
    nu_linear, nu_angular = subtract(own_linear, linear), subtract(own_angular, angular)
    own = to_frame(C, three(on_link, 6), three(on_link, 9))
    others = to_frame(C, three(on_other, 6), three(on_other, 9))
    carried = add(cross(nu_angular, linear), cross(nu_linear, angular))
    put(column, 0, add(subtract(own[0], others[0]), carried))
    put(column, 3, add(subtract(own[1], others[1]), cross(nu_angular, angular)))
    for i in range(len(rows)):
        out[i, right] = -column[rows[i]]


@part
def _ball_rows(motion: LinkMotion, link: int, numbers: Array, out: Array) -> None:
    """Fill rows of the velocity of a ball's lowest point, Eᵀ(ṗ + ω × r): J v̇ = -Eᵀ(p̈ + ω̇ × r) at v̇ = 0.

    `numbers` (15,): centre on the link, m; r from centre to lowest point in world axes, m; Eᵀ by rows.
    """
    at, right, twists, moves = motion.links[link], out.shape[1] - 1, motion.joint_twists, motion.moves
    centre = transform(motion.joints[link], three(numbers, 0))
    lowest = add(centre, three(numbers, 3))
    for j in range(len(twists)):
        if not moves[link, j]:
            out[:, j] = 0.0
        else:
            velocity = add(cross(three(twists[j], 3), lowest), three(twists[j], 0))
            for i in range(3):
                out[i, j] = dot(three(numbers, 6 + 3 * i), velocity)
    angular = three(at, 3)
    centripetal = cross(angular, add(three(at, 0), cross(angular, centre)))
    drift = add(add(three(at, 6), cross(three(at, 9), lowest)), centripetal)
    for i in range(3):
        out[i, right] = -dot(three(numbers, 6 + 3 * i), drift)


@part
def _frame_rows(
    motion: LinkMotion, link: int, first: int, size: int, numbers: Array, rows: Indices, out: Array, error: Array,
    memory: Array,
) -> None:  # fmt: skip
    """Fill rows of a frame task in world axes: J v̇ = ẍ_ref + D (ẋ_ref - ẋ) + K e - J̇v.

    `numbers`: placement of the frame on its link, (12,); K, D; reference position, quaternion, or both; ẋ_ref, ẍ_ref.
    `rows` (r,) are selected from `size` twist components from `first` on: 0, or 3 for an orientation. `out`: [J, …, b],
    (r, …); `error`: task error, (r,).
    """
    at, twist, drift, wanted = memory[0], memory[1], memory[2], memory[3]
    place(motion.joints[link], numbers, at)
    _frame_jacobian(motion, link, three(at, 9), first, rows, out, memory[4])
    on_link = motion.links[link]
    angular = three(on_link, 3)
    linear = add(three(on_link, 0), cross(angular, three(at, 9)))
    put_motion(twist, (linear, angular))
    spatial = add(three(on_link, 6), cross(three(on_link, 9), three(at, 9)))
    put_motion(drift, (add(spatial, cross(angular, linear)), three(on_link, 9)))
    reference, right = 12 + 2 * size, out.shape[1] - 1
    velocity = reference
    if first == 0:
        put(wanted, 0, subtract(three(numbers, reference), three(at, 9)))
        velocity += 3
    if first + size > 3:
        put(wanted, 3, _rotation_error(at, numbers[velocity : velocity + 4], memory[4]))
        velocity += 4
    acceleration = velocity + size
    for i in range(len(rows)):
        axis = rows[i]
        row = first + axis
        K, D = numbers[12 + axis], numbers[12 + size + axis]
        error[i] = wanted[row]
        asked = K * wanted[row] + D * (numbers[velocity + axis] - twist[row]) + numbers[acceleration + axis]
        out[i, right] = asked - drift[row]


@part
def _frame_jacobian(
    motion: LinkMotion, link: int, p: Vector3, first: int, rows: Indices, out: Array, column: Array
) -> None:
    twists, moves = motion.joint_twists, motion.moves
    for j in range(len(twists)):
        if not moves[link, j]:
            out[:, j] = 0.0
        else:
            angular = three(twists[j], 3)
            put_motion(column, (add(three(twists[j], 0), cross(angular, p)), angular))
            for i in range(len(rows)):
                out[i, j] = column[first + rows[i]]


@part
def _rotation_error(frame: Array, reference: Array, q: Array) -> Vector3:
    """Return log(R_ref Rᵀ) for a placement and a reference quaternion of any length; `q` is memory, (4,)."""
    quaternion(frame, q)
    a, w = three(reference, 0), reference[3]
    b = three(q, 0)
    # reference times the conjugate of q
    e = subtract(subtract(scale(q[3], a), scale(w, b)), cross(a, b))
    cosine = w * q[3] + dot(a, b)
    if cosine < 0.0:
        e, cosine = scale(-1.0, e), -cosine
    sine = math.sqrt(dot(e, e))
    # angle / sin(angle / 2), and 2 / cosine for small angles
    return scale(2.0 * math.atan2(sine, cosine) / sine if sine > 1.0e-9 * cosine else 2.0 / cosine, e)


@part
def _com_rows(motion: LinkMotion, numbers: Array, rows: Indices, out: Array, error: Array) -> None:
    """Fill rows of a centre of mass task; `numbers`: K, D, position, velocity, acceleration, (3,) each."""
    per_mass = motion.per_mass
    for i in range(len(rows)):
        k = rows[i]
        copy(per_mass[:, k], out[i])
        error[i] = numbers[6 + k] - motion.com[k]
        asked = numbers[k] * error[i] + numbers[3 + k] * (numbers[9 + k] - motion.com_velocity[k])
        out[i, out.shape[1] - 1] = asked + numbers[12 + k] - motion.com_drift[k]


@part
def _joint_targets(
    q: Array, v: Array, numbers: Array, places: Indices, count: int, target: Array, error: Array
) -> float:
    """Move targets to the accelerations of a joint task, and write its errors; return the constant cost.

    `numbers` (7, count): K, D, position, velocity, acceleration, share of the way from the target of earlier tasks to
    the desired acceleration, factor from its square to twice the constant cost. `places` (2, count): indices in q, v.
    """
    rest, table, index = 0.0, numbers[: 7 * count].reshape(7, count), places[: 2 * count].reshape(2, count)
    for i in range(count):
        row, column = index[0, i], index[1, i]
        if not (0 <= row < len(q) and 0 <= column < len(v)):
            raise IndexError("joint index out of range of q or v")
        error[i] = table[2, i] - q[row]
        asked = table[0, i] * error[i] + table[1, i] * (table[3, i] - v[column]) + table[4, i]
        way = asked - target[column]
        target[column] += table[5, i] * way
        rest += 0.5 * table[6, i] * way * way
    return rest


@compiled
def fill_rows(table: FrameRows, q: Vector, v: Vector, errors: OutVector) -> float:
    """Fill all contact and task rows at q and v; write task errors, and return the constant cost of joint tasks."""
    motion, instructions, places, rest = table.motion, table.instructions, table.places, 0.0
    memory = np.empty((5, 12))
    table.target[:] = 0.0
    for k in range(len(instructions)):
        step = instructions[k]
        kind, link, first, size = step[KIND], step[LINK], step[FIRST], step[SIZE]
        rows = places[step[PLACE] : step[PLACE] + step[COUNT]]
        out = table.out[step[ROW] : step[ROW] + step[COUNT]]
        numbers, error = table.numbers[step[NUMBER] :], errors[step[ERROR] :]
        if kind == FRAME:
            _frame_rows(motion, link, first, size, numbers, rows, out, error, memory)
        elif kind == COM:
            _com_rows(motion, numbers, rows, out, error)
        elif kind == JOINTS:
            rest += _joint_targets(q, v, numbers, places[step[PLACE] :], size, table.target, error)
        elif kind == SURFACE:
            _contact_rows(motion, link, step[OTHER], numbers, rows, out, memory)
        elif kind == BALL:
            _ball_rows(motion, link, numbers, out)
        elif kind == MOMENTUM:
            copy_rows(motion.centroidal.T, out)
            drift = motion.drift
            for i in range(len(out)):
                out[i, out.shape[1] - 1] = -drift[i]
    return rest
