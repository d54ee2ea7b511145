"""A four-bar linkage, driven at its crank, follows a trajectory: a closed loop and two joints without a motor.

The URDF is a tree: the pin between coupler and rocker is missing in it, and stands under `loops`. In MuJoCo, whose own
joints close the loop.
"""

import sys

import numpy as np

from wbc_controller.assembly.preflight import check
from wbc_controller.core.references.changes import SetTrajectory
from wbc_controller.core.references.trajectories import Knot
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings

CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.5, 0.4, 0.5  # m; a crank that can turn all the way round
BAR = """
  <link name="{name}"><inertial><origin xyz="{half} 0 0"/><mass value="{mass}"/>
    <inertia ixx="{small}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/></inertial></link>
  <joint name="{name}_joint" type="revolute"><parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-10" upper="10" effort="20" velocity="20"/></joint>"""


def bar(name: str, parent: str, at: float, length: float) -> str:
    """A thin rod along x that turns about y at its end, as URDF."""
    mass = 2.0 * length
    moment = mass * length**2 / 12.0
    return BAR.format(name=name, parent=parent, at=at, half=length / 2.0, mass=mass, moment=moment, small=0.01 * moment)


def closed(crank: float) -> tuple[float, float]:
    """Angles of coupler and rocker for one of the crank, with the pin above the ground; a turn about y takes x down."""
    x, z = CRANK * np.cos(crank), -CRANK * np.sin(crank)  # end of the crank
    between = np.hypot(GROUND - x, z)
    ahead = np.arctan2(z, GROUND - x)  # from there to the rocker's pivot, clockwise
    corner = np.arccos((COUPLER**2 + between**2 - ROCKER**2) / (2.0 * COUPLER * between))
    coupler = ahead - corner
    tip = np.array([x + COUPLER * np.cos(coupler), z - COUPLER * np.sin(coupler)])
    return coupler - crank, np.arctan2(-tip[1], tip[0] - GROUND)


def configuration() -> tuple[Settings, str]:
    """The linkage with the crank along x."""
    urdf = (
        '<robot name="four_bar"><link name="ground"/>'
        + bar("crank", "ground", 0.0, CRANK)
        + bar("coupler", "crank", CRANK, COUPLER)
        + bar("rocker", "ground", GROUND, ROCKER)
        + "</robot>"
    )
    values = {
        "robot": {
            "base": "fixed",
            "joints": ["crank_joint", "coupler_joint", "rocker_joint"],
            "passive_joints": {"coupler_joint": {}, "rocker_joint": {}},
            "posture": [0.0, *closed(0.0)],
        },
        "loops": {
            "pin": {
                "frame_a": "coupler", "translation_a": [COUPLER, 0.0, 0.0],
                "frame_b": "rocker", "translation_b": [ROCKER, 0.0, 0.0],
                # The linkage is planar: out of its plane the pin holds nothing, and about y it turns.
                "mask": [True, False, True, False, False, False],
            }
        },
        "tasks": {"crank": {"type": "posture", "joints": ["crank_joint"], "stiffness": 400.0}},
    }  # fmt: skip
    return Settings.model_validate(values), urdf


def main() -> int:
    """Turn the crank once round and half back; 0 where all targets are met."""
    settings, urdf = configuration()
    for finding in check(settings, urdf):
        print(f"{finding.subject}: {finding.text}")
    robot = Simulation(settings, urdf)
    dynamics, pin = robot.controller.dynamics, robot.controller.contacts["pin"]
    opened, off, kinematics, accelerations, forecast = [], [], [], [], []

    def look(robot: Simulation) -> None:
        crank, coupler, rocker = dynamics.q
        opened.append(np.abs(pin.error(dynamics)).max())
        off.append(abs(crank - robot.board.sample(robot.time).tasks["crank"].position[0]))
        turned = np.array([coupler, rocker]) - closed(crank)
        kinematics.append(np.abs(np.arctan2(np.sin(turned), np.cos(turned))).max())
        robot.plant.forward()
        accelerations.append(np.abs(robot.solution.v_dot).max())
        forecast.append(np.abs(robot.solution.v_dot - robot.plant.acceleration()).max())

    knots = (Knot(2.0, np.array([2.0 * np.pi]), np.zeros(1), np.zeros(1)),
             Knot(3.0, np.array([np.pi]), np.zeros(1), np.zeros(1)))  # fmt: skip
    robot.apply(SetTrajectory("crank", None, knots))
    robot.run(3.2, look)
    targets = [
        ("crank off its reference", max(off), 2.0e-3, "rad"),
        ("crank at the end", abs(dynamics.q[0] - np.pi), 1.0e-3, "rad"),
        ("loop open", 1e3 * max(opened), 0.05, "mm"),
        ("coupler and rocker off the linkage's geometry", max(kinematics), 2.0e-4, "rad"),
        ("accelerations, QP against MuJoCo, of the largest", max(forecast) / max(accelerations), 0.03, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.3g} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
