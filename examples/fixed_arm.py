"""An arm bolted to the ground reaches three poses, in MuJoCo, and works its gripper, whose second finger follows.

The URDF says that one finger mimics the other: it is in no list here, and is not read from the joint states. The motor
of the first moves both.
"""

import sys

import numpy as np
import pinocchio as pin

from wbc_controller.assembly.preflight import check
from wbc_controller.core.references.changes import SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings

ARM = [f"panda_joint{number}" for number in range(1, 8)]
POSTURE = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
OPEN, CLOSED = 0.035, 0.005  # m, each finger
REACHES = (  # m, and a rotation vector, rad, both from the pose in the posture, world axes
    ([0.10, 0.20, 0.05], [0.0, 0.0, 0.5]),
    ([0.05, -0.25, -0.20], [0.3, 0.0, -0.5]),
    ([-0.10, 0.0, 0.15], [0.0, 0.4, 0.0]),
)


def configuration() -> Settings:
    """Franka's Panda at 500 Hz."""
    values = {
        "robot": {
            "urdf": "package://example-robot-data/robots/panda_description/urdf/panda.urdf",
            "base": "fixed",
            "joints": [*ARM, "panda_finger_joint1"],
            "posture": [*POSTURE, OPEN],
            "armature": 0.1,
        },
        "limits": {"position_margin": 0.002},
        "tasks": {
            "hand": {"type": "frame_pose", "frame": "panda_hand_tcp", "weight": 100.0, "stiffness": 200.0},
            "gripper": {"type": "posture", "joints": ["panda_finger_joint1"], "weight": 10.0, "stiffness": 400.0},
            "posture": {"type": "posture", "joints": ARM, "weight": 0.01, "stiffness": 20.0},
        },
    }
    return Settings.model_validate(values)


def main() -> int:
    """Reach, and grip at the end of each reach; 0 where all targets are met."""
    settings = configuration()
    for finding in check(settings):
        print(f"{finding.subject}: {finding.text}")
    robot = Simulation(settings)
    model, dynamics = robot.controller.model, robot.controller.dynamics
    tool = model.frame_id("panda_hand_tcp", "fixed_arm.py")
    finger = model.q_index[model.joints.index("panda_finger_joint1")]
    start = dynamics.placement(tool).copy()
    away, turned, gripped, apart, share, forecast, size = [], [], [], [], [], [], []

    def look(robot: Simulation) -> None:
        robot.plant.forward()
        apart.append(robot.plant.coupling_error())
        share.append(np.max(np.abs(robot.solution.tau) / model.effort_limits))
        size.append(np.linalg.norm(robot.solution.v_dot))
        forecast.append(np.linalg.norm(robot.solution.v_dot - robot.plant.acceleration()))

    for move, turn in REACHES:
        goal = pin.SE3(pin.exp3(np.array(turn)) @ start.rotation, start.translation + move)
        robot.apply(
            SetSetpoint("hand", pin.SE3ToXYZQUAT(goal)),
            SetSetpoint("gripper", np.array([CLOSED if len(away) % 2 == 0 else OPEN])),
        )
        robot.run(1.4, look)
        error = goal.actInv(dynamics.placement(tool))
        away.append(np.linalg.norm(error.translation))
        turned.append(np.linalg.norm(pin.log3(error.rotation)))
        gripped.append(abs(dynamics.q[finger] - (CLOSED if len(away) % 2 else OPEN)))
    targets = [
        ("tool off its goals", 1e3 * max(away), 0.5, "mm"),
        ("tool turned from its goals", max(turned), 0.002, "rad"),
        ("finger off its goals", 1e3 * max(gripped), 0.2, "mm"),
        ("second finger off the first", 1e3 * max(apart), 0.01, "mm"),
        ("share of the torque limits used", max(share), 0.9, ""),
        ("accelerations, QP against MuJoCo, of the largest", max(forecast) / max(size), 0.01, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.3g} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
