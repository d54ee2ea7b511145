"""A cart on four `rolling` contacts drives ahead and is pushed from the side, in MuJoCo."""

import sys

import numpy as np

import wbc_controller as wbc

RADIUS, WAY, PUSH = 0.1, 0.6, 30.0  # m, m, N
WHEELS = {"front_left": "0.3 0.2", "front_right": "0.3 -0.2", "rear_left": "-0.3 0.2", "rear_right": "-0.3 -0.2"}  # m
LINK = """
  <link name="{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/>
    <inertia ixx="{3}" ixy="0" ixz="0" iyy="{4}" iyz="0" izz="{3}"/></inertial></link>"""
WHEEL = """
  <joint name="{0}_joint" type="revolute"><parent link="body"/><child link="{0}"/><origin xyz="{1} 0"/>
    <axis xyz="0 1 0"/><limit lower="-1000" upper="1000" effort="20" velocity="50"/></joint>"""


def configuration() -> wbc.Config:
    """Return the cart with its URDF."""
    urdf = '<robot name="cart">' + LINK.format("body", 0.1, 10.0, 0.2, 0.2)
    for name, place in WHEELS.items():
        urdf += LINK.format(name, 0, 1.0, 0.003, 0.005) + WHEEL.format(name, place)
    wheel = {"type": "rolling", "axis": [0, 1, 0], "radius": RADIUS, "friction": 0.8, "max_normal_force": 300.0}
    values = {
        "robot": {"joints": [f"{name}_joint" for name in WHEELS], "posture": [0.0] * 4},
        "limits.position": False,
        "contacts": {name: wheel | {"frame": name} for name in WHEELS},
        "tasks.drive": {"type": "frame_position", "frame": "body", "mask": [True, False, False]},
    }
    return wbc.load(values, urdf=urdf + "\n</robot>")


def main() -> int:
    """Drive; return 0 if all targets are met."""
    robot = wbc.Simulation(configuration())
    robot.run(0.1)  # settling of the wheels
    start, errors = np.array(robot.controller.dynamics.q), []

    def observe(robot: wbc.Simulation) -> None:
        robot.plant.forward()
        errors.append(np.abs(robot.result.v_dot - robot.plant.acceleration())[6:].max())

    robot.controller.set("drive", [start[0] + WAY, 0.0, 0.0])
    results = robot.run(0.6, observe)
    robot.plant.push("body", [0.0, PUSH, 0.0, 0.0, 0.0, 0.0], 0.3)
    results += robot.run(1.0, observe)
    moved = robot.controller.dynamics.q - start
    largest = max(np.abs(result.v_dot[6:]).max() for result in results)
    targets = [
        ("position error at the end", 1e3 * abs(moved[0] - WAY), 3.0, "mm"),
        ("wheel angles, error from distance / radius", np.abs(moved[7:] - moved[0] / RADIUS).max(), 0.02, "rad"),
        ("lateral displacement", 1e3 * abs(moved[1]), 2.0, "mm"),
        ("wheel accelerations, QP minus MuJoCo, share of the largest", max(errors) / largest, 0.05, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.3g} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
