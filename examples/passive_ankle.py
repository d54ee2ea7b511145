"""A pair of legs with sprung ankles stands in a stride, squats and comes up again, in MuJoCo.

The pitch of the ankles has no motor: a spring and a damper, known to the controller, give its torque. One foot is ahead
of the other, so that the ten motors that are left can put the forces where balance wants them.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

LEG = 0.35  # m, each of thigh and shank
HIP = 0.10  # m, to each side
FOOT = 0.06  # m, from the ankle to the sole
HEIGHT, STRIDE = 0.62, 0.15  # m: hip above the ankles; each foot ahead of the hip, or behind it
SQUAT = 0.10  # m
STIFFNESS, DAMPING = 25.0, 0.5  # N·m/rad, N·m·s/rad
ANKLES = ["left_ankle_pitch", "right_ankle_pitch"]
#: Of each leg: joint, axis, link that it moves, height of the joint in the link before, m, mass, and height of its
#: centre of mass.
CHAIN = (
    ("hip_yaw", "0 0 1", "hip", 0.0, 0.6, -0.02),
    ("hip_roll", "1 0 0", "fork", 0.0, 0.6, -0.02),
    ("hip_pitch", "0 1 0", "thigh", 0.0, 2.5, -LEG / 2),
    ("knee", "0 1 0", "shank", -LEG, 1.8, -LEG / 2),
    ("ankle_pitch", "0 1 0", "ankle", -LEG, 0.3, -0.01),
    ("ankle_roll", "1 0 0", "foot", 0.0, 0.7, -FOOT / 2),
)
LINK = """<link name="{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/>
<inertia ixx="{3}" iyy="{3}" izz="{3}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 {3} {4}"/>
<axis xyz="{5}"/><limit lower="-2.4" upper="2.4" effort="{6}" velocity="15"/></joint>"""


def legs() -> str:
    """The robot as URDF. The effort limit of the sprung joints is 0: nothing looks at it."""
    urdf = '<robot name="sprung_legs">' + LINK.format("pelvis", 0.15, 14.0, 0.25)
    for side, y in (("left", HIP), ("right", -HIP)):
        parent = "pelvis"
        for joint, axis, link, z, mass, centre in CHAIN:
            name, child = f"{side}_{joint}", f"{side}_{link}"
            urdf += LINK.format(child, centre, mass, 0.005 + mass * LEG**2 / 60.0)
            urdf += JOINT.format(name, parent, child, y, z, axis, 0 if name in ANKLES else 120)
            parent, y = child, 0.0
    return urdf + "</robot>"


def bent(ahead: float) -> list[float]:
    """Angles of a leg whose ankle is that far ahead of the hip, m, with the foot level."""
    half = np.arccos(np.hypot(ahead, HEIGHT) / (2.0 * LEG))
    hip = -np.arctan2(ahead, HEIGHT) - half
    return [0.0, 0.0, hip, 2.0 * half, -hip - 2.0 * half, 0.0]


def configuration() -> wbc.Config:
    """The legs in a stride, left foot ahead, with the springs at rest."""
    posture = {f"left_{joint}": angle for (joint, *_), angle in zip(CHAIN, bent(STRIDE), strict=True)}
    posture |= {f"right_{joint}": angle for (joint, *_), angle in zip(CHAIN, bent(-STRIDE), strict=True)}
    spring = {"stiffness": STIFFNESS, "damping": DAMPING}
    sole = {"type": "surface", "translation": [0.03, 0.0, -FOOT], "half_length": 0.1, "half_width": 0.04}
    values = {
        "robot": {
            "joints": list(posture),
            "posture": list(posture.values()),
            "passive_joints": {name: spring | {"rest": posture[name]} for name in ANKLES},
            "armature": 0.01,
        },
        "tasks": {
            "com": {"type": "com", "weight": 100.0},
            "pelvis": {"type": "frame_orientation", "frame": "pelvis", "weight": 10.0},
            "posture": {"type": "posture", "weight": 0.001, "stiffness": 20.0},
        },
        "contacts": {name: sole | {"frame": name, "max_normal_force": 500.0} for name in ("left_foot", "right_foot")},
    }
    return wbc.load(values, urdf=legs())


def main() -> int:
    """Squat and come up in two seconds; 0 where all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    model, dynamics, contacts = robot.controller.model, robot.controller.dynamics, robot.controller.contacts
    data = model.pinocchio.createData()
    ankles = [model.joints.index(name) for name in ANKLES]
    start, bend, wrong, forecast = np.array(dynamics.com), [], [], []

    def look(robot: wbc.Simulation) -> None:
        robot.plant.forward()
        wrenches = robot.plant.contact_wrenches()
        q, v = robot.plant.state()
        # What MuJoCo's motion and contact forces say of the torque at the ankles, by inverse dynamics.
        force = pin.rnea(model.pinocchio, data, q, v, robot.plant.acceleration())
        force -= sum(contacts[name].jacobian(dynamics).T @ wrench for name, wrench in wrenches.items())
        turned = q[model.q_index][ankles] - model.posture[ankles]
        spring = -STIFFNESS * turned - DAMPING * v[model.v_index][ankles]
        bend.append(np.max(np.abs(turned)))
        wrong.append(np.max(np.abs(force[model.v_index][ankles] - spring)))
        forecast.append(np.linalg.norm([robot.result.forces[name] - wrench for name, wrench in wrenches.items()]))

    robot.run(0.3)  # until the soles have settled
    robot.controller.follow("com", [1.0, 2.0], [start - [0.0, 0.0, SQUAT], start])
    results = robot.run(2.2, look)
    off = [result.task_errors["com"] for result in results]
    targets = [
        ("centre of mass off its reference", 1e3 * max(off), 1.0, "mm"),
        ("centre of mass at the end", 1e3 * off[-1], 0.2, "mm"),
        ("pelvis tilted", max(result.task_errors["pelvis"] for result in results), 0.002, "rad"),
        ("torque of the ankles, MuJoCo's against the springs'", max(wrong), 1.0e-6, "N·m"),
        ("contact forces, QP against MuJoCo, of the weight", max(forecast) / (model.mass * model.gravity), 0.02, ""),
        ("motors", float(len(robot.result.tau)), 10.0, ""),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.3g} {unit} (at most {most:g})")
    bent_by, least = max(bend), 0.1
    print(f"ankles bent by: {bent_by:.3g} rad (at least {least:g})")
    return int(not (bent_by >= least and all(value <= most for _, value, most, _ in targets)))


if __name__ == "__main__":
    sys.exit(main())
