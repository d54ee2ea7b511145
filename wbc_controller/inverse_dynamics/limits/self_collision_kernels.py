"""Kernels of `limits.self_collision`."""

import math

from wbc_controller.compilation import (
    IndexMatrix,
    Indices,
    Matrix,
    OutIndices,
    OutMatrix,
    OutVector,
    Struct,
    Vector,
    compiled,
    copy,
    part,
)
from wbc_controller.inverse_dynamics.robot.link_motion_kernels import LinkMotion
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    Vector3,
    add,
    cross,
    dot,
    scale,
    subtract,
    three,
    transform,
)
from wbc_controller.records import Array

#: Largest increase of a closing speed in a cycle without a row, m/s; rows with smaller requirements are omitted.
SPEED_INCREASE = 0.2


class ShapePairs(Struct):
    """Pairs of shapes with a minimum distance; a lever is the largest speed of a shape per unit of a component of v."""

    shape_links: Indices  # of each shape, (s,)
    mounts: Matrix  # origin on the link and enclosing radius of each shape, (s, 4) in m
    pairs: IndexMatrix  # (k, 2)
    starts: Indices  # first lever of each shape, end, (s + 1,)
    components: Indices  # component of v of each lever, from link to root, (e,)
    levers: Vector  # (e,)
    places: Indices  # index in q of each component of v, or -1, (nv,)
    ends: IndexMatrix  # indices in `sums` of the levers that can close each pair, (k, 2)
    normals: Matrix  # unit vectors from the first to the second shape, (k, 3)
    first: Matrix  # nearest points on the first shape, (k, 3) in m
    second: Matrix  # on the second shape, (k, 3) in m
    seen: OutVector  # in place: last configuration, (nq,); initially NaN
    least: OutVector  # in place: lower bounds of distances, (k,) in m, or NaN
    sums: OutMatrix  # out: cumulative largest speed and change since `seen`, (e + 1, 2)
    near: OutIndices  # out: pairs that may need a row, (k,)
    reach: OutVector  # out: their largest distances for a row, (k,) in m


@part
def _reach(closing: float, A: float, T: float, margin: float) -> float:
    """Return the distance below which a pair with the largest closing speed w may need a row.

    w_f² / (2 A) + w_f T + w T + margin, with the speed w_f = w + `SPEED_INCREASE` after a cycle without a row.
    """
    w = closing + SPEED_INCREASE
    return w * w / (2.0 * A) + w * T + closing * T + margin


@part
def _closing_speed(line: Vector3, length: float, radii: float, velocity: Vector3) -> float:
    """Return the largest speed along normals in the cone about the line of centres around two spheres.

    `line` points from the first centre to the second; `velocity` is relative to the first sphere.
    """
    if not length > radii:  # any normal is possible
        return math.sqrt(dot(velocity, velocity))
    radial, sine = -dot(velocity, line) / length, radii / length
    across = dot(velocity, velocity) - radial * radial
    closing = math.sqrt(across) * sine if not across < 0.0 else 0.0
    closing += radial if not radial < 0.0 else radial * math.sqrt(1.0 - sine * sine)
    return 0.0 if closing < 0.0 else closing


@part
def _ball_distance(table: ShapePairs, motion: LinkMotion, first: int, second: int) -> tuple[float, float]:
    """Return the distance of two enclosing spheres, and the largest closing speed of the shapes."""
    links, a, b = motion.links, table.shape_links[first], table.shape_links[second]
    center_a = transform(motion.joints[a], three(table.mounts[first], 0))
    center_b = transform(motion.joints[b], three(table.mounts[second], 0))
    radius_a, radius_b = table.mounts[first, 3], table.mounts[second, 3]
    angular = subtract(three(links[b], 3), three(links[a], 3))
    linear = subtract(three(links[b], 0), three(links[a], 0))
    # The relative twist has the same normal velocity at both nearest points: use the smaller sphere.
    a_is_smaller = radius_a < radius_b
    center, radius = (center_a, radius_a) if a_is_smaller else (center_b, radius_b)
    velocity = add(cross(angular, center), linear)
    line = subtract(center_b, center_a)
    length = math.sqrt(dot(line, line))
    closing = _closing_speed(line, length, radius_a + radius_b, velocity)
    return length - (radius_a + radius_b), closing + radius * math.sqrt(dot(angular, angular))


@part
def _sum_levers(table: ShapePairs, q: Array, v: Array) -> None:
    for shape in range(len(table.shape_links)):
        speed, change = 0.0, 0.0
        for i in range(table.starts[shape], table.starts[shape + 1]):
            j = table.components[i]
            place = table.places[j]
            turned = abs(q[place] - table.seen[place]) if place >= 0 else 0.0
            if v[j] != 0.0:  # prismatic joints without limits have infinite levers
                speed += abs(v[j]) * table.levers[i]
            if turned != 0.0:
                change += turned * table.levers[i]
            table.sums[i + 1, 0], table.sums[i + 1, 1] = speed, change


@compiled
def near_pairs(table: ShapePairs, motion: LinkMotion, q: Vector, v: Vector, A: float, T: float, margin: float) -> int:
    """Find the pairs of shapes that may need a row, by lower bounds of their distances; return their number.

    First bound: the last bound minus possible joint motion. If a pair could not brake within it with the deceleration A
    over the horizon T, second bound: the distance of enclosing spheres, with a tighter closing speed. Pairs with NaN
    are included.
    """
    if len(q) != len(table.seen) or len(v) != len(table.places):
        raise ValueError("near_pairs: sizes of q and v differ from nq and nv")
    _sum_levers(table, q, v)
    copy(q, table.seen)
    count = 0
    for i in range(len(table.pairs)):
        a, b = table.ends[i, 0], table.ends[i, 1]
        table.least[i] -= table.sums[a, 1] + table.sums[b, 1]
        limit = _reach(table.sums[a, 0] + table.sums[b, 0], A, T, margin)
        if table.least[i] > limit:
            continue
        apart, closing = _ball_distance(table, motion, table.pairs[i, 0], table.pairs[i, 1])
        if not table.least[i] > apart:
            table.least[i] = apart
        tighter = _reach(closing, A, T, margin)
        if tighter < limit:
            limit = tighter
        if not table.least[i] > limit:
            table.near[count], table.reach[count] = i, limit
            count += 1
    return count


@part
def _turning(table: ShapePairs, motion: LinkMotion, shape: int, normal: Vector3, p: Vector3) -> float:
    """Return nᵀ (ω × v(p)), the classical minus the spatial acceleration, without a separating centripetal part."""
    i = table.shape_links[shape]
    link, center = motion.links[i], transform(motion.joints[i], three(table.mounts[shape], 0))
    angular = three(link, 3)
    carried = dot(normal, cross(angular, add(three(link, 0), cross(angular, center))))
    about = dot(normal, cross(angular, cross(angular, subtract(p, center))))
    return carried if about > 0.0 else carried + about


@compiled
def distance_rows(
    table: ShapePairs, motion: LinkMotion, chosen: Indices, rows: OutMatrix, rates: OutVector, drifts: OutVector
) -> None:
    """Write J_d (m, nv) with ḋ = J_d v, the rates ḋ, and δ with d̈ ≥ J_d v̇ + δ, for `chosen` pairs (m,)."""
    count = len(chosen)
    if not (rows.shape == (count, len(motion.joint_twists)) and len(rates) == count and len(drifts) == count):
        raise ValueError("distance_rows: sizes of rows, rates, drifts and pairs differ")
    for i in range(count):
        pair = chosen[i]
        if not 0 <= pair < len(table.pairs):
            raise IndexError("distance_rows: pair index out of range")
        one, other = table.pairs[pair, 0], table.pairs[pair, 1]
        a, b = table.shape_links[one], table.shape_links[other]
        normal, p, p_other = three(table.normals[pair], 0), three(table.first[pair], 0), three(table.second[pair], 0)
        moment = cross(p, normal)
        for j in range(len(motion.joint_twists)):
            sign, column = motion.moves[b, j] - motion.moves[a, j], motion.joint_twists[j]
            along = dot(normal, three(column, 0)) + dot(moment, three(column, 3))
            rows[i, j] = sign * along if sign != 0 else 0.0
        first, second = motion.links[a], motion.links[b]
        velocity, turn = subtract(three(second, 0), three(first, 0)), subtract(three(second, 3), three(first, 3))
        rates[i] = dot(normal, velocity) + dot(moment, turn)
        linear, angular = subtract(three(second, 6), three(first, 6)), subtract(three(second, 9), three(first, 9))
        spatial = dot(normal, linear) + dot(moment, angular)
        first_turning = _turning(table, motion, one, scale(-1.0, normal), p)
        drifts[i] = spatial + first_turning + _turning(table, motion, other, normal, p_other)
