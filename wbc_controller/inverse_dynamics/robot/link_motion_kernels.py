"""Kernel for twists and drifts of all links.

Twists [linear, angular] are at the world origin in world axes; at a point p, the linear part is v₀ + ω × p. The same
holds for spatial accelerations; the classical acceleration of p adds ω × v(p). Jacobian columns are twists.
"""

from wbc_controller.compilation import Indices, Matrix, OutMatrix, OutVector, Signs, Struct, Vector, compiled, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    add,
    cross,
    put,
    put_motion,
    rotate,
    scale,
    subtract,
    three,
    to_world,
)


class LinkMotion(Struct):
    """Results of Pinocchio at one state, and the output of `link_terms`."""

    joints: Matrix  # placements in the world, (n, 12); link 0 is the world
    local_twists: Matrix  # of the links in their own axes, (n, 6)
    local_accelerations: Matrix  # spatial accelerations at v̇ = 0 minus gravity, in link axes, (n, 6)
    wrenches: Matrix  # [F, N] on each subtree at v̇ = 0, minus gravity, in link axes, (n, 6)
    roots: Indices  # of the trees, (r,)
    gravity: Vector  # g, (3,) in m/s²
    mass: float  # kg
    com: Vector  # c, (3,) in m
    centroidal: Matrix  # A_Gᵀ, (nv, 6)
    joint_twists: Matrix  # (nv, 6)
    moves: Signs  # 1 if a component of v moves a link, (n, nv)
    links: OutMatrix  # out: twists and spatial accelerations at v̇ = 0, at the world origin, (n, 12)
    per_mass: OutMatrix  # out: A_Gᵀ / m, (nv, 6); first the Jacobian of c
    com_velocity: OutVector  # out: ċ, (3,) in m/s
    com_drift: OutVector  # out: c̈ at v̇ = 0, (3,) in m/s²
    drift: OutVector  # out: rate of the momentum about c at v̇ = 0, (6,) in N and N·m


@part
def _momentum_rate(motion: LinkMotion) -> None:
    """Write the momentum rate about c at v̇ = 0: [Σ F + m g, Σ N + (p - c) × F]."""
    force, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(len(motion.roots)):
        frame, wrench = motion.joints[motion.roots[i]], motion.wrenches[motion.roots[i]]
        F, N = rotate(frame, three(wrench, 0)), rotate(frame, three(wrench, 3))
        force = add(force, F)
        moment = add(add(moment, N), cross(subtract(three(frame, 9), three(motion.com, 0)), F))
    put(motion.drift, 0, add(force, scale(motion.mass, three(motion.gravity, 0))))
    put(motion.drift, 3, moment)


@compiled
def link_terms(motion: LinkMotion, velocity: Vector) -> None:
    """Complete a link motion at a generalized velocity, (nv,)."""
    if len(velocity) != len(motion.joint_twists):
        raise ValueError("link_terms: the size of the velocity differs from nv")
    joints, links, gravity = motion.joints, motion.links, three(motion.gravity, 0)
    twists, accelerations = motion.local_twists, motion.local_accelerations
    for i in range(1, len(joints)):
        frame, link = joints[i], links[i]
        put_motion(link, to_world(frame, three(twists[i], 0), three(twists[i], 3)))
        linear, angular = to_world(frame, three(accelerations[i], 0), three(accelerations[i], 3))
        put(link, 6, add(linear, gravity))
        put(link, 9, angular)
    _momentum_rate(motion)
    per_mass, com_velocity, centroidal = motion.per_mass, motion.com_velocity, motion.centroidal
    share = 1.0 / motion.mass
    com_velocity[:] = 0.0
    com_drift, drift, mass = motion.com_drift, motion.drift, motion.mass
    for k in range(3):
        com_drift[k] = drift[k] / mass
    for j in range(len(velocity)):
        for k in range(6):
            per_mass[j, k] = share * centroidal[j, k]
        for k in range(3):
            com_velocity[k] += per_mass[j, k] * velocity[j]
