"""A four-bar linkage with a driven crank follows a trajectory, in MuJoCo: a closed loop and two passive joints.

The URDF is a tree; the pin between coupler and rocker is defined in `loops`.
"""

import sys

import numpy as np

import wbc_controller as wbc

CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.5, 0.4, 0.5  # m; the crank can rotate fully


def bar(name: str, parent: str, at: float, length: float) -> str:
    """Return the URDF of a thin rod along x that rotates about y at its end."""
    mass = 2.0 * length
    moment = mass * length**2 / 12.0
    return f"""
  <link name="{name}"><inertial><origin xyz="{length / 2.0} 0 0"/><mass value="{mass}"/>
    <inertia ixx="{0.01 * moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/></inertial></link>
  <joint name="{name}_joint" type="revolute"><parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-10" upper="10" effort="20" velocity="20"/></joint>"""


def closed(crank: float) -> tuple[float, float]:
    """Return the angles of coupler and rocker for an angle of the crank, with the pin above the ground."""
    x, z = CRANK * np.cos(crank), -CRANK * np.sin(crank)  # end of the crank
    between = np.hypot(GROUND - x, z)
    ahead = np.arctan2(z, GROUND - x)  # direction to the rocker's pivot, clockwise
    corner = np.arccos((COUPLER**2 + between**2 - ROCKER**2) / (2.0 * COUPLER * between))
    coupler = ahead - corner
    tip = np.array([x + COUPLER * np.cos(coupler), z - COUPLER * np.sin(coupler)])
    return coupler - crank, np.arctan2(-tip[1], tip[0] - GROUND)


def configuration() -> wbc.Config:
    """Return the linkage with the crank along x."""
    bars = bar("crank", "ground", 0.0, CRANK) + bar("coupler", "crank", CRANK, COUPLER)
    bars += bar("rocker", "ground", GROUND, ROCKER)
    values = {
        "robot": {
            "base": "fixed",
            "joints": ["crank_joint", "coupler_joint", "rocker_joint"],
            "passive_joints": {"coupler_joint": {}, "rocker_joint": {}},
            "posture": [0.0, *closed(0.0)],
        },
        "loops.pin": {
            "frame_a": "coupler", "translation_a": [COUPLER, 0.0, 0.0],
            "frame_b": "rocker", "translation_b": [ROCKER, 0.0, 0.0],
            # Planar: two constrained translations.
            "mask": [True, False, True, False, False, False],
        },
        "tasks.crank": {"type": "posture", "joints": ["crank_joint"], "stiffness": 400.0},
    }  # fmt: skip
    return wbc.load(values, urdf=f'<robot name="four_bar"><link name="ground"/>{bars}</robot>')


def main() -> int:
    """Rotate the crank one turn forward and half a turn back; return 0 if all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    dynamics, loop = robot.controller.dynamics, robot.controller.contacts["pin"]
    opened, forecast = [], []

    def observe(robot: wbc.Simulation) -> None:
        opened.append(np.abs(loop.error(dynamics)).max())
        robot.plant.forward()
        forecast.append(np.abs(robot.result.v_dot - robot.plant.acceleration()).max())

    robot.controller.follow("crank", [2.0, 3.0], [[2.0 * np.pi], [np.pi]])
    results = robot.run(3.2, observe)
    q = np.array([result.state.q for result in results])
    turned = np.angle(np.exp(1j * (q[:, 1:] - [closed(crank) for crank in q[:, 0]])))  # modulo full turns
    largest = max(np.abs(result.v_dot).max() for result in results)
    targets = [
        ("error of the crank", max(result.task_errors["crank"] for result in results), 2.0e-3, "rad"),
        ("error of the crank at the end", abs(q[-1, 0] - np.pi), 1.0e-3, "rad"),
        ("error of the loop", 1e3 * max(opened), 0.05, "mm"),
        ("error of coupler and rocker", np.abs(turned).max(), 2.0e-4, "rad"),
        ("accelerations, QP minus MuJoCo, share of the largest", max(forecast) / largest, 0.03, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.3g} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
