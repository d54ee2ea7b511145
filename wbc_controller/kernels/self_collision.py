"""Distances of links that are kept apart: how near they may have come, their rates, and bounds of their acceleration.

The equations are those of `core.limits.self_collision`. Twists and spatial accelerations are at the world's origin, in
world axes, as in `kernels.frames`.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.kernels.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    INDICES,
    NUMBER,
    ROWS,
    ROWS_OUT,
    SIGN_ROWS,
    VECTOR,
    VECTOR_OUT,
    compiled,
    part,
)
from wbc_controller.records import Array


@part
def _reach(closing: float, A: float, T: float, faster: float, margin: float) -> float:
    w = closing + faster
    return float(w * w / (2.0 * A) + w * T + closing * T + margin)


@compiled(ANY_VECTOR, VECTOR, INDICES, ANY_VECTOR, ROWS, NUMBER, NUMBER, NUMBER, NUMBER, VECTOR_OUT, VECTOR_OUT)
def approach(
    q: Array, seen: Array, places: np.ndarray, v: Array, leverage: Array, A: float, T: float, faster: float,
    margin: float, least: Array, reach: Array,
) -> None:  # fmt: skip
    """How near pairs may have come since their distances were known, and how near they may come without a row.

    Args:
        q: configuration, (nq,).
        seen: that of which the lower bounds of the distances were, (nq,).
        places: where the position of each component of v stands in q, -1 where it changes no distance, (nv,).
        v: generalized velocity, (nv,).
        leverage: largest change of each pair's distance by each component of v, (nv, pairs).
        A: deceleration, m/s².
        T: horizon, s.
        faster: by what the closing speed of a pair without a row may grow in a cycle, m/s.
        margin: least distance, m.
        least: lower bounds of the distances, (pairs,) in m, in place.
        reach: for the distances below which pairs may need a row, (pairs,) in m, as `reach_of` has them.
    """
    for i in range(len(least)):
        reach[i] = 0.0
    for j in range(len(v)):
        speed = abs(v[j])
        turned = abs(q[places[j]] - seen[places[j]]) if places[j] >= 0 else 0.0
        if speed != 0.0 or turned != 0.0:  # NaN is not
            row = leverage[j]
            for i in range(len(least)):
                reach[i] += speed * row[i]
                least[i] -= turned * row[i]
    for i in range(len(least)):
        reach[i] = _reach(reach[i], A, T, faster, margin)


@compiled(VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, VECTOR_OUT)
def reach_of(closing: Array, A: float, T: float, faster: float, margin: float, out: Array) -> None:
    """Distances below which pairs with at most these closing speeds may need a row.

    They are w_f² / (2 A) + w_f T + w T + margin, with w_f = w + faster the closing speed after a cycle without a row.

    Args:
        closing: w, (k,) in m/s.
        A: deceleration, m/s².
        T: horizon, s.
        faster: by what w may grow in a cycle without a row, m/s.
        margin: least distance, m.
        out: for the distances, (k,) in m.
    """
    for i in range(len(closing)):
        out[i] = _reach(closing[i], A, T, faster, margin)


@part
def _cross(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    return b * z - c * y, c * x - a * z, a * y - b * x


@part
def _about(motion: Array, n: Array, p: Array, centre: Array, side: float) -> float:
    """What the turning of a shape adds to the second derivative of a distance, beside its spatial acceleration.

    It is the difference of classical and spatial acceleration at p, nᵀ (ω × v(p)); its centripetal part about the
    shape's origin counts only where it brings the links nearer.
    """
    a, b, c = side * n[0], side * n[1], side * n[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    x, y, z = _cross(a, b, c, wx, wy, wz)
    nw, ww = a * wx + b * wy + c * wz, wx * wx + wy * wy + wz * wz
    carried = motion[0] * x + motion[1] * y + motion[2] * z
    carried += nw * (wx * centre[0] + wy * centre[1] + wz * centre[2])
    carried -= ww * (a * centre[0] + b * centre[1] + c * centre[2])
    rx, ry, rz = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    about = nw * (wx * rx + wy * ry + wz * rz) - ww * (a * rx + b * ry + c * rz)
    if not about > 0.0:
        carried += about
    return float(carried)


@compiled(
    ROWS, ROWS, ROWS, INDICES, INDICES, INDICES, ROWS, ANY_MATRIX, SIGN_ROWS, ROWS, ROWS_OUT, VECTOR_OUT, VECTOR_OUT
)
def distance_rows(
    normals: Array, first: Array, second: Array, first_shapes: np.ndarray, second_shapes: np.ndarray,
    shape_links: np.ndarray, shapes: Array, J: Array, moves: np.ndarray, links: Array, rows: Array, rate: Array,
    drift: Array,
) -> None:  # fmt: skip
    """Rows J_d with ḋ = J_d v, the rates ḋ, and the drift δ with d̈ ≥ J_d v̇ + δ, of pairs of shapes.

    Args:
        normals: unit vectors from the nearest points on the first shapes to those on the second ones, (k, 3).
        first: these points on the first shapes, in the world, (k, 3) in m.
        second: those on the second shapes, (k, 3) in m.
        first_shapes: index of each pair's first shape, (k,).
        second_shapes: index of its second one, (k,).
        shape_links: index of the link of each shape, (n,).
        shapes: placements of the shapes in the world, (n, 12).
        J: joint Jacobians, (6, nv).
        moves: 1 where a joint moves a link, (links, nv).
        links: motions at the world's origin, (links, 12), of `frames.link_terms`.
        rows: for J_d, (k, nv).
        rate: for ḋ, (k,) in m/s.
        drift: for δ, (k,) in m/s².
    """
    for i in range(len(normals)):
        n, p = normals[i], first[i]
        a, b = shape_links[first_shapes[i]], shape_links[second_shapes[i]]
        x, y, z = _cross(p[0], p[1], p[2], n[0], n[1], n[2])
        for j in range(J.shape[1]):
            sign = moves[b, j] - moves[a, j]
            along = n[0] * J[0, j] + n[1] * J[1, j] + n[2] * J[2, j] + x * J[3, j] + y * J[4, j] + z * J[5, j]
            rows[i, j] = sign * along if sign != 0 else 0.0
        speed, spatial = 0.0, 0.0
        for c in range(6):
            share = n[c] if c < 3 else x if c == 3 else y if c == 4 else z
            speed += share * (links[b, c] - links[a, c])
            spatial += share * (links[b, 6 + c] - links[a, 6 + c])
        spatial += _about(links[a], n, p, shapes[first_shapes[i], 9:], -1.0)
        spatial += _about(links[b], n, second[i], shapes[second_shapes[i], 9:], 1.0)
        rate[i], drift[i] = speed, spatial


@compiled(VECTOR, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER, VECTOR_OUT)
def acceleration_apart(
    distance: Array, rate: Array, margin: float, A: float, T: float, return_speed: float, most: float, out: Array
) -> None:
    """Lower bounds of d̈ that leave room to stop before the margin: (-ḋ - w_max) / T, NaN where d or ḋ is.

    Args:
        distance: d, (k,) in m.
        rate: ḋ, (k,) in m/s.
        margin: least distance, m.
        A: deceleration, m/s².
        T: horizon, s.
        return_speed: largest speed with which links that are too near part, m/s.
        most: largest acceleration that is asked for, m/s².
        out: for the bounds, (k,) in m/s².
    """
    for i in range(len(distance)):
        room = distance[i] - margin + T * rate[i]
        if room != room:
            out[i] = math.nan
            continue
        reach = A * T
        fastest = math.sqrt(reach * reach + 2.0 * A * room) - reach if room > 0.0 else max(room / T, -return_speed)
        out[i] = min((-rate[i] - fastest) / T, most)
