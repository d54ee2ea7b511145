"""A pair of legs with sprung ankles stands in a stride, squats and comes up again, in MuJoCo.

The pitch of the ankles has no motor: a spring and a damper, known to the controller, give its torque. One foot is ahead
of the other, so that the ten motors that are left can put the forces where balance wants them.
"""

import sys

import numpy as np
import pinocchio as pin

from wbc_controller.assembly.preflight import check
from wbc_controller.core.references.changes import SetTrajectory
from wbc_controller.core.references.trajectories import Knot
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings

LEG = 0.35  # m, each of thigh and shank
HIP = 0.10  # m, to each side
FOOT = 0.06  # m, from the ankle to the sole
HEIGHT, STRIDE = 0.62, 0.15  # m: hip above the ankles; each foot ahead of the hip, or behind it
SQUAT = 0.10  # m
STIFFNESS, DAMPING = 25.0, 0.5  # N·m/rad, N·m·s/rad
#: Of each leg: joint, axis, link that it moves, origin in the link before, mass, and where its centre of mass is.
CHAIN = (
    ("hip_yaw", "0 0 1", "hip", (0.0, 0.0, 0.0), 0.6, -0.02),
    ("hip_roll", "1 0 0", "fork", (0.0, 0.0, 0.0), 0.6, -0.02),
    ("hip_pitch", "0 1 0", "thigh", (0.0, 0.0, 0.0), 2.5, -LEG / 2),
    ("knee", "0 1 0", "shank", (0.0, 0.0, -LEG), 1.8, -LEG / 2),
    ("ankle_pitch", "0 1 0", "ankle", (0.0, 0.0, -LEG), 0.3, -0.01),
    ("ankle_roll", "1 0 0", "foot", (0.0, 0.0, 0.0), 0.7, -FOOT / 2),
)
LINK = """<link name="{name}"><inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>
<axis xyz="{axis}"/><limit lower="-2.4" upper="2.4" effort="{effort}" velocity="15"/></joint>"""


def legs() -> str:
    """The robot as URDF. The effort limit of the sprung joints is 0: nothing looks at it."""
    parts = [LINK.format(name="pelvis", z=0.15, mass=14.0, i=0.25)]
    for side, y in (("left", HIP), ("right", -HIP)):
        parent = "pelvis"
        for joint, axis, link, (x, own, z), mass, centre in CHAIN:
            child, at = f"{side}_{link}", f"{x} {own + y if parent == 'pelvis' else own} {z}"
            effort = 0 if joint == "ankle_pitch" else 120
            parts.append(LINK.format(name=child, z=centre, mass=mass, i=0.005 + mass * LEG**2 / 60.0))
            parts.append(
                JOINT.format(name=f"{side}_{joint}", parent=parent, child=child, xyz=at, axis=axis, effort=effort)
            )
            parent = child
    return f'<robot name="sprung_legs">{"".join(parts)}</robot>'


def bent(ahead: float) -> list[float]:
    """Angles of a leg whose ankle is that far ahead of the hip, m, with the foot level."""
    length = np.hypot(ahead, HEIGHT)
    half = np.arccos(length / (2.0 * LEG))
    hip = -np.arctan2(ahead, HEIGHT) - half
    return [0.0, 0.0, hip, 2.0 * half, -hip - 2.0 * half, 0.0]


def configuration() -> Settings:
    """The legs in a stride, left foot ahead, with the springs at rest."""
    joints = [f"{side}_{joint}" for side in ("left", "right") for joint, *_ in CHAIN]
    posture = [*bent(STRIDE), *bent(-STRIDE)]
    rest = dict(zip(joints, posture, strict=True))
    sole = {"type": "surface", "translation": [0.03, 0.0, -FOOT], "half_length": 0.1, "half_width": 0.04}
    values = {
        "robot": {
            "joints": joints,
            "posture": posture,
            "passive_joints": {
                name: {"stiffness": STIFFNESS, "damping": DAMPING, "rest": rest[name]}
                for name in ("left_ankle_pitch", "right_ankle_pitch")
            },
            "armature": 0.01,
        },
        "tasks": {
            "com": {"type": "com", "weight": 100.0},
            "pelvis": {"type": "frame_orientation", "frame": "pelvis", "weight": 10.0},
            "posture": {"type": "posture", "weight": 0.001, "stiffness": 20.0},
        },
        "contacts": {
            f"{side}_foot": sole | {"frame": f"{side}_foot", "max_normal_force": 500.0} for side in ("left", "right")
        },
    }
    return Settings.model_validate(values)


def main() -> int:
    """Squat and come up in two seconds; 0 where all targets are met."""
    settings, urdf = configuration(), legs()
    for finding in check(settings, urdf):
        print(f"{finding.subject}: {finding.text}")
    robot = Simulation(settings, urdf)
    model, dynamics = robot.controller.model, robot.controller.dynamics
    data = model.pinocchio.createData()
    ankles = [model.joints.index(f"{side}_ankle_pitch") for side in ("left", "right")]
    start, still = np.array(dynamics.com), np.zeros(3)
    off, tilt, bend, wrong, forecast = [], [], [], [], []

    def look(robot: Simulation) -> None:
        off.append(np.linalg.norm(dynamics.com - robot.board.sample(robot.time).tasks["com"].position))
        tilt.append(np.linalg.norm(pin.log3(pin.XYZQUATToSE3(np.array(dynamics.q[:7])).rotation)))
        robot.plant.forward()
        wrenches = robot.plant.contact_wrenches()
        q, v = robot.plant.state()
        # What MuJoCo's motion and contact forces say of the torque at the ankles, by inverse dynamics.
        force = pin.rnea(model.pinocchio, data, q, v, robot.plant.acceleration())
        for name, wrench in wrenches.items():
            force -= robot.controller.contacts[name].jacobian(dynamics).T @ wrench
        angle, speed = q[model.q_index][ankles], v[model.v_index][ankles]
        spring = STIFFNESS * (model.posture[ankles] - angle) - DAMPING * speed
        bend.append(np.max(np.abs(angle - model.posture[ankles])))
        wrong.append(np.max(np.abs(force[model.v_index][ankles] - spring)))
        expected = np.concatenate([robot.solution.forces[name] for name in wrenches])
        forecast.append(np.linalg.norm(expected - np.concatenate(list(wrenches.values()))))

    robot.run(0.3)  # until the soles have settled
    down = start - [0.0, 0.0, SQUAT]
    robot.apply(SetTrajectory("com", None, (Knot(1.0, down, still, still), Knot(2.0, start, still, still))))
    robot.run(2.2, look)
    targets = [
        ("centre of mass off its reference", 1e3 * max(off), 1.0, "mm"),
        ("centre of mass at the end", 1e3 * off[-1], 0.2, "mm"),
        ("pelvis tilted", max(tilt), 0.002, "rad"),
        ("torque of the ankles, MuJoCo's against the springs'", max(wrong), 1.0e-6, "N·m"),
        ("contact forces, QP against MuJoCo, of the weight", max(forecast) / (model.mass * model.gravity), 0.02, ""),
        ("motors", float(len(robot.solution.tau)), 10.0, ""),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.3g} {unit} (at most {most:g})")
    bent_by, least = max(bend), 0.1
    print(f"ankles bent by: {bent_by:.3g} rad (at least {least:g})")
    return int(not (bent_by >= least and all(value <= most for _, value, most, _ in targets)))


if __name__ == "__main__":
    sys.exit(main())
