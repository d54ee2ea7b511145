"""Legs with passive ankles squat in a stride, in MuJoCo.

The ankle pitch joints have springs and dampers in place of motors. In a stride the other ten motors can balance.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

LEG = 0.35  # length of thigh and shank, m
HIP = 0.10  # lateral offset of the hips, m
FOOT = 0.06  # height of the ankle above the sole, m
HEIGHT, STRIDE = 0.62, 0.15  # height of the hip above the ankles, distance of the feet from the hip, m
SQUAT = 0.10  # m
STIFFNESS, DAMPING = 25.0, 0.5  # N·m/rad, N·m·s/rad
ANKLES = ["left_ankle_pitch", "right_ankle_pitch"]
#: Joints of a leg: name, axis, moved link, height in the parent link, m, mass, kg, height of the centre of mass, m.
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
    """Return the URDF. The effort limit of passive joints is not used."""
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
    """Return the joint angles of a leg with level foot and the ankle at a distance ahead of the hip, m."""
    half = np.arccos(np.hypot(ahead, HEIGHT) / (2.0 * LEG))
    hip = -np.arctan2(ahead, HEIGHT) - half
    return [0.0, 0.0, hip, 2.0 * half, -hip - 2.0 * half, 0.0]


def configuration() -> wbc.Config:
    """Return the legs in a stride, left foot ahead, with relaxed springs."""
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
    """Squat and rise in two seconds; return 0 if all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    model, dynamics, contacts = robot.controller.model, robot.controller.dynamics, robot.controller.contacts
    data = model.pinocchio.createData()
    ankles = [model.joints.index(name) for name in ANKLES]
    start, bend, wrong, forecast = np.array(dynamics.com), [], [], []

    def observe(robot: wbc.Simulation) -> None:
        robot.plant.forward()
        wrenches = robot.plant.contact_wrenches()
        q, v = robot.plant.state()
        # Ankle torques by inverse dynamics, from motion and contact forces of MuJoCo.
        force = pin.rnea(model.pinocchio, data, q, v, robot.plant.acceleration())
        force -= sum(contacts[name].jacobian(dynamics).T @ wrench for name, wrench in wrenches.items())
        turned = q[model.q_index][ankles] - model.posture[ankles]
        spring = -STIFFNESS * turned - DAMPING * v[model.v_index][ankles]
        bend.append(np.max(np.abs(turned)))
        wrong.append(np.max(np.abs(force[model.v_index][ankles] - spring)))
        forecast.append(np.linalg.norm([robot.result.forces[name] - wrench for name, wrench in wrenches.items()]))

    robot.run(0.3)  # settling of the soles
    robot.controller.follow("com", [1.0, 2.0], [start - [0.0, 0.0, SQUAT], start])
    results = robot.run(2.2, observe)
    off = [result.task_errors["com"] for result in results]
    targets = [
        ("error of the centre of mass", 1e3 * max(off), 1.0, "mm"),
        ("error of the centre of mass at the end", 1e3 * off[-1], 0.2, "mm"),
        ("orientation error of the pelvis", max(result.task_errors["pelvis"] for result in results), 0.002, "rad"),
        ("ankle torques, MuJoCo minus springs", max(wrong), 1.0e-6, "N·m"),
        (
            "contact forces, QP minus MuJoCo, share of the weight",
            max(forecast) / (model.mass * model.gravity),
            0.02,
            "",
        ),
        ("motors", float(len(robot.result.tau)), 10.0, ""),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.3g} {unit} (at most {most:g})")
    bent_by, least = max(bend), 0.1
    print(f"motion of the ankles: {bent_by:.3g} rad (at least {least:g})")
    return int(not (bent_by >= least and all(value <= most for _, value, most, _ in targets)))


if __name__ == "__main__":
    sys.exit(main())
