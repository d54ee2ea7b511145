"""Points of links as seen from an IMU, and the base from the IMU (`estimation.leg_kinematics`)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    INDICES,
    INTEGER,
    NUMBER,
    ROWS,
    ROWS_OUT,
    SIGN_ROWS,
    VECTOR,
    VECTOR_OUT,
    compile_all,
    compiled,
)
from wbc_controller.inverse_dynamics.robot.placement_kernels import cross, place, quaternion, turn, turn_back
from wbc_controller.records import Array


@compiled(
    ROWS, ANY_MATRIX, SIGN_ROWS, INDICES, INTEGER, VECTOR, INDICES, ROWS, VECTOR, NUMBER, NUMBER, ROWS_OUT, ROWS_OUT,
    ROWS_OUT, ROWS_OUT,
)  # fmt: skip
def sights(
    joints: Array, J: Array, moves: np.ndarray, links: np.ndarray, own: int, imu: Array, ends: np.ndarray,
    points: Array, v: Array, joint_noise: float, point_noise: float, places: Array, covariance: Array, turning: Array,
    rates: Array,
) -> None:  # fmt: skip
    """Points of links as seen from an IMU, in its axes: Rᵀ r, and d (Rᵀ r) = Rᵀ (dr + r × dθ) as the IMU turns by dθ.

    Args:
        joints: placements of the links, (n, 12).
        J: joint Jacobians, (6, nv).
        moves: 1 where a joint moves a link, (n, nv).
        links: index of each link with points, (c,).
        own: index of the link with the IMU.
        imu: placement of the IMU, (12,).
        ends: after which of the points those of each link end, (c,).
        points: in the axes of their link, (k, 3) in m.
        v: velocity, (nv,); its first 6 components, those of the base, do not count.
        joint_noise: of each joint's position, rad, one standard deviation.
        point_noise: of each coordinate of a point beside that, m, one standard deviation.
        places: for Rᵀ r, (k, 3) in m.
        covariance: for its covariance, (3 k, 3 k) in m².
        turning: for the angular velocity of each link, (c, 3) in rad/s.
        rates: for the time derivative of `places`, (k, 3) in m/s.
    """
    k, c, nv = len(points), len(links), J.shape[1]
    if not (J.shape[0] == 6 and len(v) == nv and moves.shape == (len(joints), nv) and joints.shape[1] == 12):
        raise ValueError("sights: joints, J, moves or v have sizes that do not agree")
    if not (len(imu) == 12 and len(ends) == c and points.shape[1] == 3 and (c == 0 or ends[c - 1] == k)):
        raise ValueError("sights: imu, ends or points have another size than the links ask for")
    if not (places.shape == rates.shape == (k, 3) and covariance.shape == (3 * k, 3 * k) and turning.shape == (c, 3)):
        raise ValueError("sights: places, rates, covariance or turning have another size than the points")
    seen, change = np.empty((k, 3)), np.empty(3 * k)
    covariance[:] = 0.0
    turning[:] = 0.0
    rates[:] = 0.0
    start = 0
    for i in range(c):
        at = joints[links[i]]
        for n in range(start, ends[i]):
            x, y, z = turn(at, points[n, 0], points[n, 1], points[n, 2])
            seen[n, 0], seen[n, 1], seen[n, 2] = x + at[9], y + at[10], z + at[11]
            places[n, 0], places[n, 1], places[n, 2] = turn_back(
                imu, seen[n, 0] - imu[9], seen[n, 1] - imu[10], seen[n, 2] - imu[11]
            )
        start = ends[i]
    for j in range(6, J.shape[1]):
        wx, wy, wz = J[3, j], J[4, j], J[5, j]
        low, high = 3 * k, 0  # the rows between are moved by this joint
        start = 0
        for i in range(c):
            moved = moves[links[i], j] != 0
            if moved:
                turning[i, 0] += wx * v[j]
                turning[i, 1] += wy * v[j]
                turning[i, 2] += wz * v[j]
            if moved or moves[own, j] != 0:
                low, high = min(low, 3 * start), 3 * ends[i]
            for n in range(start, ends[i]):
                x, y, z = 0.0, 0.0, 0.0
                px, py, pz = seen[n, 0], seen[n, 1], seen[n, 2]
                if moved:
                    cx, cy, cz = cross(wx, wy, wz, px, py, pz)
                    x, y, z = J[0, j] + cx, J[1, j] + cy, J[2, j] + cz
                if moves[own, j] != 0:
                    cx, cy, cz = cross(wx, wy, wz, imu[9], imu[10], imu[11])
                    dx, dy, dz = cross(px - imu[9], py - imu[10], pz - imu[11], wx, wy, wz)
                    x, y, z = x - J[0, j] - cx + dx, y - J[1, j] - cy + dy, z - J[2, j] - cz + dz
                change[3 * n], change[3 * n + 1], change[3 * n + 2] = turn_back(imu, x, y, z)
                for axis in range(3):
                    rates[n, axis] += change[3 * n + axis] * v[j]
            start = ends[i]
        for a in range(low, high):
            share = joint_noise**2 * change[a]
            for b in range(low, high):
                covariance[a, b] += share * change[b]
    for a in range(3 * k):
        covariance[a, a] += point_noise**2


@compiled(ROWS, ANY_MATRIX, SIGN_ROWS, INTEGER, VECTOR, VECTOR, VECTOR_OUT, VECTOR_OUT)
def imu_on_base(
    joints: Array, J: Array, moves: np.ndarray, own: int, mount: Array, v: Array, imu: Array, motion: Array
) -> None:  # fmt: skip
    """Placement of an IMU on a base in the world's origin, and its motion against it, in the base's axes.

    Args:
        joints: placements of the links, (n, 12).
        J: joint Jacobians, (6, nv).
        moves: 1 where a joint moves a link, (n, nv).
        own: index of the link with the IMU.
        mount: placement of the IMU on that link, (12,).
        v: velocity, (nv,); its first 6 components, those of the base, do not count.
        imu: for its placement on the base, (12,).
        motion: for its twist, (6,) in m/s and rad/s.
    """
    if not (J.shape[0] == 6 and len(v) == J.shape[1] and moves.shape == (len(joints), len(v))):
        raise ValueError("imu_on_base: joints, J, moves or v have sizes that do not agree")
    if not (joints.shape[1] == 12 and len(mount) == 12 and len(imu) == 12 and len(motion) == 6):
        raise ValueError("imu_on_base: a placement or a twist has another size than 12 or 6")
    place(joints[own], mount, imu)
    motion[:] = 0.0
    for j in range(6, J.shape[1]):
        if moves[own, j] != 0:
            for i in range(6):
                motion[i] += J[i, j] * v[j]
    x, y, z = cross(motion[3], motion[4], motion[5], imu[9], imu[10], imu[11])
    motion[0], motion[1], motion[2] = motion[0] + x, motion[1] + y, motion[2] + z


@compiled(ROWS, ROWS, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR_OUT, VECTOR_OUT)
def base_of_imu(
    R: Array, columns: Array, angular_velocity: Array, bias: Array, imu: Array, motion: Array, world: Array,
    shift: Array, pose: Array, twist: Array,
) -> None:  # fmt: skip
    """Pose and twist of the base from those of the IMU, in a world that is turned about the vertical and shifted.

    Args:
        R: from the axes of the IMU to the filter's world, (3, 3).
        columns: velocity and position of the IMU in that world are the first two, (3, n).
        angular_velocity: as the gyroscope measures it, (3,) in rad/s.
        bias: of the gyroscope, (3,) in rad/s.
        imu: placement of the IMU on the base, (12,).
        motion: twist of the IMU against the base, at the IMU and in the base's axes, (6,).
        world: cosine and sine of the turn from the filter's world to the other, (2,).
        shift: from the one to the other, (3,) in m.
        pose: for position and quaternion (x, y, z, w) of the base in the other world, (7,).
        twist: for the base's twist in its own axes, (6,).
    """
    if not (R.shape == (3, 3) and columns.shape[0] == 3 and columns.shape[1] >= 2 and len(imu) == 12):
        raise ValueError("base_of_imu: R, columns or imu have another size")
    if not (len(angular_velocity) == 3 and len(bias) == 3 and len(motion) == 6 and len(world) == 2 and len(shift) == 3):
        raise ValueError("base_of_imu: a velocity, the bias, world or shift has another size")
    if not (len(pose) == 7 and len(twist) == 6):
        raise ValueError("base_of_imu: pose or twist has another size than 7 or 6")
    wx, wy, wz = turn(imu, angular_velocity[0] - bias[0], angular_velocity[1] - bias[1], angular_velocity[2] - bias[2])
    wx, wy, wz = wx - motion[3], wy - motion[4], wz - motion[5]
    B, turned = np.empty(9), np.empty(9)  # the base's axes by columns: R times the rows of the IMU's
    for j in range(3):
        for i in range(3):
            B[3 * j + i] = R[i, 0] * imu[j] + R[i, 1] * imu[3 + j] + R[i, 2] * imu[6 + j]
    vx, vy, vz = turn_back(B, columns[0, 0], columns[1, 0], columns[2, 0])
    cx, cy, cz = cross(wx, wy, wz, imu[9], imu[10], imu[11])
    twist[0], twist[1], twist[2] = vx - cx - motion[0], vy - cy - motion[1], vz - cz - motion[2]
    twist[3], twist[4], twist[5] = wx, wy, wz
    x, y, z = turn(B, imu[9], imu[10], imu[11])
    x, y, z = columns[0, 1] - x, columns[1, 1] - y, columns[2, 1] - z
    cosine, sine = world[0], world[1]
    pose[0], pose[1], pose[2] = cosine * x - sine * y + shift[0], sine * x + cosine * y + shift[1], z + shift[2]
    for j in range(3):
        turned[3 * j] = cosine * B[3 * j] - sine * B[3 * j + 1]
        turned[3 * j + 1] = sine * B[3 * j] + cosine * B[3 * j + 1]
        turned[3 * j + 2] = B[3 * j + 2]
    quaternion(turned, pose[3:])


@compiled(ROWS, ANY_VECTOR, VECTOR, VECTOR, VECTOR, ROWS, ROWS, INDICES, ROWS, ROWS, NUMBER, NUMBER, ROWS_OUT)
def slowest_contact(
    R: Array, velocity: Array, omega: Array, imu: Array, motion: Array, places: Array, rates: Array, ends: np.ndarray,
    turning: Array, radii: Array, share: float, fastest: float, mean: Array,
) -> float:  # fmt: skip
    """Update the mean velocity of each contact in the world, and return the smallest speed (`estimation.consistency`).

    A point at y from the IMU has the velocity u = v + R (ω × y + ẏ). From the centre of a ball on a link that turns by
    ω_l, the contact point is at -r n and has the velocity u - ω_l × r n.

    Args:
        R: from the IMU's axes to the world, (3, 3).
        velocity: v of the IMU in the world, (3,) in m/s.
        omega: ω of the IMU in its axes, (3,) in rad/s.
        imu: placement of the IMU on the base, (12,).
        motion: twist of the IMU against the base, in the base's axes, (6,).
        places: y of each point, in the IMU's axes, (k, 3) in m.
        rates: ẏ of each point, (k, 3) in m/s.
        ends: index after the last point of each contact, (c,).
        turning: angular velocity of each contact's link against the base, in the base's axes, (c, 3) in rad/s.
        radii: r n of each ball in the world, zero of other contacts, (c, 3) in m.
        share: weight of the present velocities in the means.
        fastest: speed to which the present velocities are limited, m/s.
        mean: mean velocity of each contact in the world, (c, 3) in m/s; updated.

    Returns:
        The smallest norm of the means, m/s.
    """
    k, c = len(places), len(ends)
    if not (R.shape == (3, 3) and len(velocity) == len(omega) == 3 and len(imu) == 12 and len(motion) == 6):
        raise ValueError("slowest_contact: R, velocity, omega, imu or motion have another size")
    if not (places.shape == rates.shape == (k, 3) and (c == 0 or ends[c - 1] == k)):
        raise ValueError("slowest_contact: places or rates have another size than the contacts")
    if not (turning.shape == radii.shape == mean.shape == (c, 3)):
        raise ValueError("slowest_contact: turning, radii or mean have another size than the contacts")
    slowest, start, w, u = math.inf, 0, np.empty(3), np.empty(3)
    for i in range(len(ends)):
        x, y, z = 0.0, 0.0, 0.0
        for n in range(start, ends[i]):
            cx, cy, cz = cross(omega[0], omega[1], omega[2], places[n, 0], places[n, 1], places[n, 2])
            x, y, z = x + cx + rates[n, 0], y + cy + rates[n, 1], z + cz + rates[n, 2]
        count = ends[i] - start
        x, y, z = x / count, y / count, z / count
        ax, ay, az = turn_back(imu, turning[i, 0] - motion[3], turning[i, 1] - motion[4], turning[i, 2] - motion[5])
        ax, ay, az = ax + omega[0], ay + omega[1], az + omega[2]
        for axis in range(3):
            w[axis] = R[axis, 0] * ax + R[axis, 1] * ay + R[axis, 2] * az
            u[axis] = velocity[axis] + R[axis, 0] * x + R[axis, 1] * y + R[axis, 2] * z
        rx, ry, rz = cross(w[0], w[1], w[2], radii[i, 0], radii[i, 1], radii[i, 2])
        u[0], u[1], u[2] = u[0] - rx, u[1] - ry, u[2] - rz
        speed = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        limit = fastest / speed if speed > fastest else 1.0
        total = 0.0
        for axis in range(3):
            mean[i, axis] += share * (limit * u[axis] - mean[i, axis])
            total += mean[i, axis] * mean[i, axis]
        slowest = min(slowest, math.sqrt(total))
        start = ends[i]
    return slowest


compile_all()
