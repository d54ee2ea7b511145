"""Robots and small mechanisms that the tests of mechanics share, and random states and constraints of them."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import strategies as st

from wbc_controller import mechanics
from wbc_controller.settings.resources import locate

ROBOTS = {
    "panda": "panda_description/urdf/panda.urdf",
    "go2": "go2_description/urdf/go2.urdf",
    "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
    "romeo": "romeo_description/urdf/romeo.urdf",
    "icub": "icub_description/robots/icub.urdf",
    "simple_humanoid": "simple_humanoid_description/urdf/simple_humanoid.urdf",
}
FIXED = ("panda",)
FLOATING = tuple(name for name in ROBOTS if name not in FIXED)
#: Strategies of Hypothesis: all robots, floating ones, and seeds.
names, floating, seeds = st.sampled_from(sorted(ROBOTS)), st.sampled_from(FLOATING), st.integers(0, 2**32 - 1)


@cache
def robot(name: str) -> pin.Model:
    urdf = locate(f"package://example-robot-data/robots/{ROBOTS[name]}").read_text(encoding="utf-8")
    model = pin.buildModelFromXML(urdf) if name in FIXED else pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    # Reflected rotor inertias, as every real robot has them.
    armature = np.full(model.nv, 0.01)
    if name not in FIXED:
        armature[:6] = 0.0
    model.armature = armature
    return model


def random_state(model: pin.Model, rng: np.random.Generator, speed: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    return q, speed * rng.normal(size=model.nv)


def random_case(name: str, seed: int) -> tuple[pin.Model, np.random.Generator, np.ndarray, np.ndarray]:
    """Robot, random numbers, and random q and v."""
    model, rng = robot(name), np.random.default_rng(seed)
    return model, rng, *random_state(model, rng)


def rate_along(
    function: Callable[..., Any], model: pin.Model, q: np.ndarray, v: np.ndarray, v_dot: np.ndarray, eps: float = 1e-6
) -> Any:
    """Time derivative of a function of q and v along a motion, by a central difference."""
    ends = [function(pin.integrate(model, q, s * v + 0.5 * s * s * v_dot), v + s * v_dot) for s in (eps, -eps)]
    return (ends[0] - ends[1]) / (2 * eps)


def links(model: pin.Model) -> list[str]:
    """Frames of links that move."""
    return [frame.name for frame in model.frames if frame.type == pin.BODY and frame.parentJoint > 0]


def random_constraint(model: pin.Model, rng: np.random.Generator) -> mechanics.Constraint:
    frames = links(model)
    first, second = (str(name) for name in rng.choice(frames, 2, replace=False))
    offset = 0.2 * rng.normal(size=3)
    joints = [model.names[j] for j in range(1, model.njoints) if model.joints[j].nq == 1]
    pair = rng.choice(joints, 2, replace=False)
    shaking = mechanics.oscillating_support(rng.normal(size=6), 0.1, 3.0)
    kinds = [
        lambda: mechanics.PointContact(frame=first, offset=offset),
        lambda: mechanics.PointContact(frame=first, offset=offset, target=offset, support=shaking, time_constant=0.1),
        lambda: mechanics.SurfaceContact(frame=first, placement=pin.SE3.Random()),
        lambda: mechanics.SurfaceContact(frame=first, support=shaking, time_constant=0.1),
        lambda: mechanics.JointCoupling(coefficients={str(pair[0]): 1.0, str(pair[1]): -2.0}),
        lambda: mechanics.PinnedFrames(first=first, second=second, second_offset=offset, time_constant=0.2),
        lambda: mechanics.WeldedFrames(first=first, second=second),
        lambda: mechanics.Rolling(frame=first, radius=0.1, centre=offset),
        lambda: mechanics.Rolling(frame=first, radius=0.1, axis=offset, normal=np.array([0.1, 0.2, 1.0])),
        lambda: mechanics.PlaneContact(frame=first, offset=offset),
    ]
    return kinds[int(rng.integers(len(kinds)))]()


def random_constraints(model: pin.Model, rng: np.random.Generator) -> list[mechanics.Constraint]:
    """Two to four constraints, at times one of them twice."""
    few = 2 if model.nv < 12 else 4
    constraints = [random_constraint(model, rng) for _ in range(int(rng.integers(1, few + 1)))]
    if rng.random() < 0.4:
        constraints.append(constraints[0])
    return constraints


def move(
    model: pin.Model, constraints: Sequence[mechanics.Constraint], q: np.ndarray, v: np.ndarray, step: float, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Motion under constraints, without other forces than gravity; see `simulate`."""
    zero, data = np.zeros(model.nv), model.createData()

    def acceleration(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return mechanics.constrained_dynamics(model, q, v, zero, constraints, t=t, data=data).v_dot

    return mechanics.simulate(model, acceleration, q, v, step, steps)


def rod_inertia(mass: float, length: float) -> pin.Inertia:
    """A thin rod from the origin along x."""
    moment = mass * length**2 / 12.0
    return pin.Inertia(mass, np.array([length / 2, 0.0, 0.0]), np.diag([1e-4 * mass, moment, moment]))


def four_bar() -> tuple[pin.Model, list[mechanics.Constraint], np.ndarray, np.ndarray]:
    """Crank, coupler and rocker in the plane x–z, the loop closed by a pin; q, and v with the crank at 5 rad/s."""
    model = pin.Model()
    crank, coupler, rocker, ground = 0.2, 0.5, 0.4, 0.5
    parent = 0
    for name, length, before in (("crank", crank, 0.0), ("coupler", coupler, crank)):
        parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([before, 0.0, 0.0])), name)
        model.appendBodyToJoint(parent, rod_inertia(2.0 * length, length), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_link", parent, 0, pin.SE3.Identity(), pin.BODY))
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), 0.05 * np.eye(3)), pin.SE3.Identity())  # a flywheel
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([ground, 0.0, 0.0])), "rocker")
    model.appendBodyToJoint(joint, rod_inertia(2.0 * rocker, rocker), pin.SE3.Identity())
    model.addFrame(pin.Frame("rocker_link", joint, 0, pin.SE3.Identity(), pin.BODY))
    # The crank along x: a triangle of coupler, rocker and what is left of the ground.
    rest = ground - crank
    at_coupler = np.arccos((coupler**2 + rest**2 - rocker**2) / (2 * coupler * rest))
    at_rocker = np.arccos((rocker**2 + rest**2 - coupler**2) / (2 * rocker * rest))
    q = np.array([0.0, -at_coupler, -(np.pi - at_rocker)])  # a positive turn about y takes x down
    loop = mechanics.PinnedFrames(
        first="coupler_link",
        second="rocker_link",
        first_offset=np.array([coupler, 0.0, 0.0]),
        second_offset=np.array([rocker, 0.0, 0.0]),
        time_constant=0.2,
    )
    A = mechanics.constraint_equation([loop], mechanics.Kinematics(model, q, np.zeros(3))).A
    (direction,) = mechanics.admissible_directions(A).T  # of three rows, two are independent
    return model, [loop], q, 5.0 / direction[0] * direction


def ball(mass: float) -> pin.Model:
    """A free ball with a radius of 0.1 m."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("ball_link", joint, 0, pin.SE3.Identity(), pin.BODY))
    return model


WHEEL_RADIUS = 0.3


def wheel_with_pendulum() -> tuple[pin.Model, list[mechanics.Constraint]]:
    """A disc that rolls in any direction, and a pendulum on its axle."""
    model = pin.Model()
    wheel = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "wheel")
    mass, r = 2.0, WHEEL_RADIUS
    disc = np.diag([0.25, 0.5, 0.25]) * mass * r**2
    model.appendBodyToJoint(wheel, pin.Inertia(mass, np.zeros(3), disc), pin.SE3.Identity())
    model.addFrame(pin.Frame("wheel_link", wheel, 0, pin.SE3.Identity(), pin.BODY))
    pendulum = model.addJoint(wheel, pin.JointModelRY(), pin.SE3.Identity(), "pendulum")
    bob = pin.Inertia(0.5, np.array([0.0, 0.0, -0.2]), np.diag([1e-3, 1e-3, 1e-3]))
    model.appendBodyToJoint(pendulum, bob, pin.SE3.Identity())
    model.addFrame(pin.Frame("pendulum_link", pendulum, 0, pin.SE3.Identity(), pin.BODY))
    rolling = mechanics.Rolling(frame="wheel_link", radius=r, axis=np.array([0.0, 1.0, 0.0]), time_constant=0.2)
    return model, [rolling]


def box(
    size: tuple[float, float, float] = (0.4, 0.3, 0.5), mass: float = 10.0
) -> tuple[pin.Model, list[mechanics.Constraint]]:
    """A free box and its four lower corners on a frictionless floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, *size), pin.SE3.Identity())
    model.addFrame(pin.Frame("box_link", joint, 0, pin.SE3.Identity(), pin.BODY))
    corners = [np.array([sx * size[0] / 2, sy * size[1] / 2, -size[2] / 2]) for sx in (1, -1) for sy in (1, -1)]
    return model, [mechanics.PlaneContact(frame="box_link", offset=corner, height=-size[2] / 2) for corner in corners]
