"""Distances of links that are kept apart: how near they may have come, their rates, and bounds of their acceleration.

The equations are those of `limits.self_collision`. Twists and spatial accelerations are at the world's origin, in
world axes, as in `robot.frame_kernels`.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_MATRIX_OUT,
    ANY_VECTOR,
    INDICES,
    INTEGER,
    NUMBER,
    ROWS_OUT,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    as_part,
    compile_all,
    compiled,
    indices,
    matrix,
    part,
    signs,
    vector,
)
from wbc_controller.inverse_dynamics.robot.placement_kernels import cross, turn
from wbc_controller.records import Array

#: Numbers that coal keeps of each pair, and where among them are the distance, the normal, and the nearest points on
#: the first and on the second shape.
RESULT, DISTANCE, NORMAL, FIRST, SECOND = 20, 7, 8, 11, 14


@part
def _reach(closing: float, A: float, T: float, faster: float, margin: float) -> float:
    """Distance below which a pair that closes with at most this speed, m/s, may need a row.

    It is w_f² / (2 A) + w_f T + w T + margin, with w_f = w + faster the closing speed after a cycle without a row.
    """
    w = closing + faster
    return float(w * w / (2.0 * A) + w * T + closing * T + margin)


@part
def _of_balls(
    a: Array, b: Array, mount_a: Array, mount_b: Array, twist_a: Array, twist_b: Array
) -> tuple[float, float]:  # fmt: skip
    """Distance of the balls that enclose two shapes, and the largest speed with which the shapes can close.

    The normal lies in the cone about the line between the balls' centres that contains both balls.

    Args:
        a: placement of the first shape's link in the world, (12,).
        b: that of the second one's, (12,).
        mount_a: the first shape's origin on its link, and the radius of the ball about it, (4,) in m.
        mount_b: those of the second one, (4,) in m.
        twist_a: twist of the first link at the world's origin, (6,).
        twist_b: that of the second link, (6,).
    """
    ax, ay, az = turn(a, mount_a[0], mount_a[1], mount_a[2])
    bx, by, bz = turn(b, mount_b[0], mount_b[1], mount_b[2])
    ax, ay, az, bx, by, bz = ax + a[9], ay + a[10], az + a[11], bx + b[9], by + b[10], bz + b[11]
    x, y, z = bx - ax, by - ay, bz - az
    length, radii = math.sqrt(x * x + y * y + z * z), mount_a[3] + mount_b[3]
    wx, wy, wz = twist_b[3] - twist_a[3], twist_b[4] - twist_a[4], twist_b[5] - twist_a[5]
    # The relative twist has the same velocity along the normal at both nearest points: take the smaller ball's.
    radius, px, py, pz = mount_b[3], bx, by, bz
    if mount_a[3] < mount_b[3]:
        radius, px, py, pz = mount_a[3], ax, ay, az
    vx, vy, vz = cross(wx, wy, wz, px, py, pz)
    vx, vy, vz = vx + twist_b[0] - twist_a[0], vy + twist_b[1] - twist_a[1], vz + twist_b[2] - twist_a[2]
    speed = vx * vx + vy * vy + vz * vz
    if length > radii:
        radial, sine = -(vx * x + vy * y + vz * z) / length, radii / length
        across = speed - radial * radial
        closing = math.sqrt(across) * sine if not across < 0.0 else 0.0
        closing += radial if not radial < 0.0 else radial * math.sqrt(1.0 - sine * sine)
    else:  # the normal may have any direction
        closing = math.sqrt(speed)
    if closing < 0.0:
        closing = 0.0
    return length - radii, closing + radius * math.sqrt(wx * wx + wy * wy + wz * wz)


@compiled(TABLE, ANY_VECTOR, ANY_VECTOR, NUMBER, NUMBER, NUMBER)
def near_pairs(table: np.ndarray, q: Array, v: Array, A: float, T: float, margin: float) -> int:
    """Find the pairs of shapes that may need a row, by lower bounds of their distances.

    The first bound is that of the last cycle, less what the joints between the two links can have changed since then.
    Where a pair could not brake within it from the speed that these joints can close it with, the second one is the
    distance of the balls that enclose the shapes, with a tighter bound of the speed.

    Args:
        table: the number of pairs k, of shapes s, of links n, nv, nq, and of levers e; and, in this order,
            pairs: indices of the two shapes of each pair, (k, 2).
            ends: where each pair's sums are in `sums`, (k, 2).
            starts: where the levers of each shape begin, and at last where they end, (s + 1,).
            components: of v, of each lever, from a shape's own link towards the root, (e,).
            levers: largest speed of any point of a shape per unit speed of that component, (e,).
            places: where the position of each component of v stands in q, -1 where it changes no distance, (nv,).
            shape_links: index of the link of each shape, (s,).
            mounts: origin of each shape on its link, and the radius of a ball about it that encloses it, (s, 4) in m.
            constants: by what the closing speed may grow in a cycle without a row, m/s; the largest speed with which
                links that are too near part, m/s; and the largest acceleration that is asked for, over A, (3,).
            joints: placements of the links in the world, (n, 12).
            links: motions of the links at the world's origin, (n, 12), of `frames.link_terms`.
            twists: joint Jacobians, column by column, (nv, 6).
            moves: 1 where a joint moves a link, (n, nv).
            shapes: placements of the shapes in the world, (s, 12).
            results: what coal found of each pair, (k, `RESULT`).
            seen: configuration of the last cycle, (nq,), in place; NaN where there was none.
            least: lower bounds of the distances, (k,) in m, in place; NaN where none is known.
            sums: for the speed, and the change since `seen`, that the levers up to each one allow, (e + 1, 2); those of
                no lever, which are 0, stand first.
            near: for the pairs that may need a row, in order, (k,).
            reach: for the distances below which these do, (k,) in m.
            found: for those of them that are so near, (k,).
            rows: for J_d of these, (k, nv).
            rates: for ḋ of these, (k,) in m/s.
            drifts: for δ of these, (k,) in m/s².
            chosen: for those of them that have a row, (k,).
            shown: the pairs of the rows, -1 where a row is unused, (k,), in place.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        A: deceleration, m/s².
        T: horizon, s.
        margin: least distance, m.

    Returns:
        Their number; NaN anywhere makes a pair one of them.
    """
    k, s, n, e = table[0], table[1], table[2], table[5]
    pairs, ends, starts = indices(table, 6, 2 * k), indices(table, 7, 2 * k), indices(table, 8, s + 1)
    components, levers, places = indices(table, 9, e), vector(table, 10, e), indices(table, 11, table[3])
    shape_links, mounts, faster = indices(table, 12, s), matrix(table, 13, s, 4), vector(table, 14, 3)[0]
    joints, links = matrix(table, 15, n, 12), matrix(table, 16, n, 12)
    seen, least, sums = vector(table, 21, table[4]), vector(table, 22, k), matrix(table, 23, e + 1, 2)
    near, reach = indices(table, 24, k), vector(table, 25, k)
    if len(q) != table[4] or len(v) != table[3]:
        raise ValueError("near_pairs: q or v has another size than the model's")
    for shape in range(s):
        speed, change = 0.0, 0.0
        for i in range(starts[shape], starts[shape + 1]):
            j = components[i]
            place = places[j]
            turned = abs(q[place] - seen[place]) if place >= 0 else 0.0
            if v[j] != 0.0:  # as a joint that slides without end makes levers infinite
                speed += abs(v[j]) * levers[i]
            if turned != 0.0:
                change += turned * levers[i]
            sums[i + 1, 0], sums[i + 1, 1] = speed, change
    for i in range(len(q)):
        seen[i] = q[i]
    count = 0
    for i in range(k):
        a, b = ends[2 * i], ends[2 * i + 1]
        least[i] -= sums[a, 1] + sums[b, 1]
        limit = _reach(sums[a, 0] + sums[b, 0], A, T, faster, margin)
        if least[i] > limit:
            continue
        first, second = pairs[2 * i], pairs[2 * i + 1]
        a, b = shape_links[first], shape_links[second]
        apart, closing = _of_balls(joints[a], joints[b], mounts[first], mounts[second], links[a], links[b])
        if not least[i] > apart:
            least[i] = apart
        tighter = _reach(closing, A, T, faster, margin)
        if tighter < limit:
            limit = tighter
        if not least[i] > limit:
            near[count], reach[count] = i, limit
            count += 1
    return count


@part
def _about(motion: Array, n: Array, p: Array, centre: Array, side: float) -> float:
    """What the turning of a shape adds to the second derivative of a distance, beside its spatial acceleration.

    It is the difference of classical and spatial acceleration at p, nᵀ (ω × v(p)); its centripetal part about the
    shape's origin counts only where it brings the links nearer.
    """
    a, b, c = side * n[0], side * n[1], side * n[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    x, y, z = cross(a, b, c, wx, wy, wz)
    nw, ww = a * wx + b * wy + c * wz, wx * wx + wy * wy + wz * wz
    carried = motion[0] * x + motion[1] * y + motion[2] * z
    carried += nw * (wx * centre[0] + wy * centre[1] + wz * centre[2])
    carried -= ww * (a * centre[0] + b * centre[1] + c * centre[2])
    rx, ry, rz = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    about = nw * (wx * rx + wy * ry + wz * rz) - ww * (a * rx + b * ry + c * rz)
    if not about > 0.0:
        carried += about
    return float(carried)


@compiled(TABLE, INDICES, ROWS_OUT, VECTOR_OUT, VECTOR_OUT)
def distance_rows(table: np.ndarray, chosen: np.ndarray, rows: Array, rates: Array, drifts: Array) -> None:
    """Rows J_d with ḋ = J_d v, the rates ḋ, and the drift δ with d̈ ≥ J_d v̇ + δ, of pairs whose distances are known.

    Args:
        table: as `near_pairs` takes it.
        chosen: the pairs, (k,).
        rows: for J_d, (k, nv).
        rates: for ḋ, (k,) in m/s.
        drifts: for δ, (k,) in m/s².
    """
    k, s, n, nv = table[0], table[1], table[2], table[3]
    pairs, shape_links = indices(table, 6, 2 * k), indices(table, 12, s)
    links, twists, moves = matrix(table, 16, n, 12), matrix(table, 17, nv, 6), signs(table, 18, n, nv)
    shapes, results = matrix(table, 19, s, 12), matrix(table, 20, k, RESULT)
    count = len(chosen)
    if not (rows.shape == (count, nv) and len(rates) == count and len(drifts) == count):
        raise ValueError("distance_rows: rows, rates or drifts have another size than the pairs")
    for i in range(count):
        if not 0 <= chosen[i] < k:
            raise IndexError("distance_rows: a pair is not below the number of pairs")
        result, one, other = results[chosen[i]], pairs[2 * chosen[i]], pairs[2 * chosen[i] + 1]
        normal, p = result[NORMAL : NORMAL + 3], result[FIRST : FIRST + 3]
        a, b = shape_links[one], shape_links[other]
        x, y, z = cross(p[0], p[1], p[2], normal[0], normal[1], normal[2])
        for j in range(nv):
            sign, J = moves[b, j] - moves[a, j], twists[j]
            along = normal[0] * J[0] + normal[1] * J[1] + normal[2] * J[2] + x * J[3] + y * J[4] + z * J[5]
            rows[i, j] = sign * along if sign != 0 else 0.0
        speed, spatial = 0.0, 0.0
        for c in range(6):
            share = normal[c] if c < 3 else x if c == 3 else y if c == 4 else z
            speed += share * (links[b, c] - links[a, c])
            spatial += share * (links[b, 6 + c] - links[a, 6 + c])
        spatial += _about(links[a], normal, p, shapes[one, 9:], -1.0)
        spatial += _about(links[b], normal, result[SECOND : SECOND + 3], shapes[other, 9:], 1.0)
        rates[i], drifts[i] = speed, spatial


_distance_rows = as_part(distance_rows)


@part
def _apart(distance: float, rate: float, margin: float, A: float, T: float, return_speed: float, most: float) -> float:
    """Lower bound of d̈ that leaves room to stop before the margin; see `acceleration_apart`."""
    room = distance - margin + T * rate
    if room != room:
        return math.nan
    reach = A * T
    fastest = math.sqrt(reach * reach + 2.0 * A * room) - reach if room > 0.0 else max(room / T, -return_speed)
    return min((-rate - fastest) / T, most)


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
    if not (len(rate) == len(distance) and len(out) == len(distance)):
        raise ValueError("acceleration_apart: distances, rates and bounds have different sizes")
    for i in range(len(distance)):
        out[i] = _apart(distance[i], rate[i], margin, A, T, return_speed, most)


@compiled(TABLE, INTEGER, NUMBER, NUMBER, NUMBER, ANY_MATRIX_OUT, VECTOR_OUT, VECTOR_OUT)
def fill_apart(
    table: np.ndarray, count: int, A: float, T: float, margin: float, rows: Array, lower: Array, upper: Array
) -> bool:
    """Rows and bounds of the pairs that need one, once coal has found the distances of those that may.

    In the order of the pairs: while the set of pairs stays the same each pair keeps its row, and the solver its warm
    start. Where there are more pairs than rows, those that ask for most have one, and of equal ones the first.

    Args:
        table: as `near_pairs` takes it.
        count: what `near_pairs` gave.
        A: deceleration, m/s².
        T: horizon, s.
        margin: least distance, m.
        rows: for J_d, (m, nv).
        lower: for the bounds of J_d v̇, (m,) in m/s²; -inf for rows that are not used.
        upper: likewise, inf.

    Returns:
        Whether `shown` has changed: the pairs of the rows.
    """
    k, nv, constants = table[0], table[3], vector(table, 14, 3)
    faster, return_speed, most = constants[0], constants[1], constants[2] * A
    results, least, near = matrix(table, 20, k, RESULT), vector(table, 22, k), indices(table, 24, k)
    reach, found, values = vector(table, 25, k), indices(table, 26, k), matrix(table, 27, k, nv)
    rates, drifts = vector(table, 28, k), vector(table, 29, k)
    chosen, shown = indices(table, 30, k), indices(table, 31, k)
    if not (rows.shape == (len(lower), nv) and len(upper) == len(lower) and count <= k):
        raise ValueError("fill_apart: rows, bounds or the number of pairs do not agree")
    close = 0
    for c in range(count):
        i = near[c]
        least[i] = distance = results[i, DISTANCE]
        if not distance > reach[c]:
            found[close] = i
            close += 1
    _distance_rows(table, found[:close], values[:close], rates[:close], drifts[:close])
    given, there = 0, len(lower)
    for c in range(close if there else 0):
        bound = _apart(results[found[c], DISTANCE], rates[c], margin, A, T, return_speed, most)
        if bound < -faster / T:
            continue
        bound -= drifts[c]
        if given == there:
            last = 0  # of those that ask for least; what is not a number asks for nothing
            for i in range(there):
                if lower[i] <= lower[last] or lower[i] != lower[i]:
                    last = i
            if not (bound > lower[last] or (lower[last] != lower[last] and bound == bound)):
                continue
            given -= 1
            for i in range(last, given):
                chosen[i], lower[i] = chosen[i + 1], lower[i + 1]
        chosen[given], lower[given] = c, bound
        given += 1
    changed = False
    for i in range(there):
        upper[i], pair = math.inf, -1
        if i < given:
            pair, own = found[chosen[i]], values[chosen[i]]
            for j in range(nv):
                rows[i, j] = own[j]
        else:
            lower[i] = -math.inf
            for j in range(nv):
                rows[i, j] = 0.0
        if i < k and shown[i] != pair:
            shown[i], changed = pair, True
    return changed


compile_all()
