"""Numbers in serialized messages (`middleware.states`, `middleware.in_place`), and the state made of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wbc_controller.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    BYTES,
    INDICES,
    INTEGER,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    compile_all,
    compiled,
    indices,
    part,
    signs,
    vector,
)
from wbc_controller.records import Array

#: Difference from 1 of a quaternion's norm up to which it is taken here, of what `tasks.form` takes: a norm at the
#: very limit is for the plain code to judge.
_NORM = 0.99e-2


@part
def _bits(payload: bytes, place: int) -> Any:
    """Eight bytes, the lowest first."""
    bits = np.uint64(0)
    for k in range(8):
        bits |= np.uint64(payload[place + k]) << np.uint64(8 * k)
    return bits


@part
def _gather(payload: bytes, places: np.ndarray, largest: float, out: Array) -> bool:
    """Copy numbers; whether none is larger than `largest`."""
    bits, good = out.view(np.uint64), True
    for i in range(len(places)):
        bits[i] = _bits(payload, places[i])
        good &= abs(out[i]) <= largest
    return good


@compiled(BYTES, TABLE, VECTOR_OUT, VECTOR_OUT)
def read(payload: bytes, table: np.ndarray, one: Array, other: Array) -> int:
    """Read a message that has the shape of another one, and two groups of numbers of it.

    Places are those of the first of eight bytes.

    Args:
        payload: the message.
        table: the sizes of `like`, `edges`, `unmeasured`, `first` and `second`; the place of the time in the header;
            the index in the first group of a unit quaternion, which is normalized, negative where there is none; and,
            in this order,
            like: the other message, (size,).
            edges: begin and end of each piece of the bytes that make up the shape, (2 n,).
            unmeasured: places of numbers that are not -1, which says that there is no measurement.
            first: places of the numbers of the first group.
            second: of the second.
            largest: the largest magnitude that a number of each group may have, (2,).
        one: takes the numbers of the first group, (len(first),).
        other: takes those of the second, (len(second),).

    Returns:
        The stamp, ns; negative where the shape is another one, or where a number or the stamp is none that this may
        take, or at the limit of that: then the codec's way finds out what to say.
    """
    size, stamp, quaternion = table[0], table[5], table[6]
    if len(payload) != size or len(one) != table[3] or len(other) != table[4] or (table[2] > 0 and len(one) == 0):
        return -1
    like, edges = signs(table, 7, 1, size)[0], indices(table, 8, table[1])
    unmeasured, first, second = (
        indices(table, 9, table[2]), indices(table, 10, table[3]), indices(table, 11, table[4])
    )  # fmt: skip
    largest = vector(table, 12, 2)
    differs = np.uint8(0)
    for k in range(0, len(edges), 2):
        for i in range(edges[k], edges[k + 1]):
            differs |= payload[i] ^ np.uint8(like[i])
    if differs:
        return -1
    time = _bits(payload, stamp)
    seconds, rest = np.int64(time & np.uint64(0xFFFFFFFF)), np.int64(time >> np.uint64(32))
    good = seconds < 1 << 31 and rest < 1_000_000_000
    one_bits = one.view(np.uint64)
    for i in range(len(unmeasured)):
        one_bits[0] = _bits(payload, unmeasured[i])
        good &= one[0] != -1.0
    good &= _gather(payload, first, largest[0], one)
    good &= _gather(payload, second, largest[1], other)
    if quaternion >= 0:
        good &= abs(_normalize(one, quaternion) - 1.0) <= _NORM
    return seconds * 1_000_000_000 + rest if good else -1


@part
def _normalize(values: Array, start: int) -> float:
    square = 0.0
    for i in range(start, start + 4):
        square += values[i] * values[i]
    norm = math.sqrt(square)
    for i in range(start, start + 4):
        values[i] /= norm
    return norm


@compiled(VECTOR_OUT, INTEGER)
def normalize(values: Array, start: int) -> float:
    """Divide the quaternion (4,) at a place by its norm, and give the norm: the same bits as `read`."""
    if start < 0 or start + 4 > len(values):
        raise IndexError("normalize: there is no quaternion at this place")
    return _normalize(values, start)


@compiled(TABLE, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR_OUT, VECTOR_OUT)
def assemble(
    table: np.ndarray, positions: Array, velocities: Array, pose: Array, twist: Array, q: Array, v: Array
) -> None:
    """Assemble q and v from measurements, as `RobotModel.state` does.

    Args:
        table: the number of joints nj, and of each joint the index in q and that in v, (nj,).
        positions: of the joints, (nj,).
        velocities: of the joints, (nj,).
        pose: position and quaternion of a floating base, (7,); (0,) for a fixed one.
        twist: of that base, (6,); (0,) for a fixed one.
        q: takes the configuration, (nq,).
        v: takes the velocity, (nv,).
    """
    q_index, v_index = indices(table, 1, table[0]), indices(table, 2, table[0])
    if not (len(positions) == len(q_index) and len(velocities) == len(q_index)):
        raise ValueError("assemble: positions or velocities have another size than the joints")
    if len(pose) > len(q) or len(twist) > len(v):
        raise ValueError("assemble: pose or twist is larger than q or v")
    q[:], v[:] = 0.0, 0.0
    for i in range(len(pose)):
        q[i] = pose[i]
    for i in range(len(twist)):
        v[i] = twist[i]
    for i in range(len(q_index)):
        if not (0 <= q_index[i] < len(q) and 0 <= v_index[i] < len(v)):
            raise IndexError("assemble: the index of a joint is not below the size of q or v")
        q[q_index[i]] = positions[i]
        v[v_index[i]] = velocities[i]


@part
def _stamped(numbers: Array, place: int, nanoseconds: int) -> None:
    """Write the time of a header: seconds in the lower half of eight bytes, nanoseconds in the upper one."""
    if place >= 0:
        seconds = nanoseconds // 1_000_000_000
        rest = nanoseconds - 1_000_000_000 * seconds
        numbers.view(np.int64)[place] = (seconds & 0xFFFFFFFF) | (rest << 32)


@part
def _put(numbers: Array, fields: np.ndarray, k: int, values: Array) -> bool:
    """Write a group of numbers to its place; whether it is as large as that."""
    start, end = fields[2 * k], fields[2 * k + 1]
    if len(values) != end - start:
        return False
    for i in range(len(values)):
        numbers[start + i] = values[i]
    return True


@compiled(VECTOR_OUT, INTEGER, INTEGER, INDICES, ANY_VECTOR, ANY_VECTOR, ANY_VECTOR)
def write(
    numbers: Array, stamp: int, nanoseconds: int, fields: np.ndarray, one: Array, two: Array, three: Array
) -> bool:
    """Write a time and three groups of numbers, which may be empty, into a message.

    Args:
        numbers: the message from its first number on, (n,).
        stamp: place of the time in the header, in `numbers`; negative where there is none.
        nanoseconds: the time.
        fields: begin and end of each group, (6,).
        one: numbers of the first group.
        two: of the second.
        three: of the third.

    Returns:
        Whether each group is as large as its place.
    """
    _stamped(numbers, stamp, nanoseconds)
    return _put(numbers, fields, 0, one) and _put(numbers, fields, 1, two) and _put(numbers, fields, 2, three)


@compiled(VECTOR_OUT, INTEGER, INTEGER, INDICES, ANY_MATRIX, ANY_VECTOR)
def write_product(
    numbers: Array, stamp: int, nanoseconds: int, fields: np.ndarray, matrix: Array, vector: Array
) -> bool:
    """Write a time and the product of a matrix, (m, k), and a vector, (k,), into a message, as `write`."""
    if matrix.shape[0] != fields[1] - fields[0] or matrix.shape[1] != len(vector):
        return False
    _stamped(numbers, stamp, nanoseconds)
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        numbers[fields[0] + i] = total
    return True


compile_all()
