"""An arm on a fixed base reaches three poses and moves its gripper, in MuJoCo.

The second finger is a mimic joint of the URDF: it is not configured, and one motor moves both fingers.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

ARM = [f"panda_joint{number}" for number in range(1, 8)]
POSTURE = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
OPEN, CLOSED = 0.035, 0.005  # m, each finger
REACHES = (  # displacement, m, and rotation vector, rad, from the pose in the posture, world axes; finger position, m
    ([0.10, 0.20, 0.05], [0.0, 0.0, 0.5], CLOSED),
    ([0.05, -0.25, -0.20], [0.3, 0.0, -0.5], OPEN),
    ([-0.10, 0.0, 0.15], [0.0, 0.4, 0.0], CLOSED),
)
#: Franka's Panda at 500 Hz.
PANDA = {
    "robot": {
        "urdf": "package://example-robot-data/robots/panda_description/urdf/panda.urdf",
        "base": "fixed",
        "joints": [*ARM, "panda_finger_joint1"],
        "posture": [*POSTURE, OPEN],
        "armature": 0.1,
    },
    "limits.position_margin": 0.002,
    "tasks": {
        "hand": {"type": "frame_pose", "frame": "panda_hand_tcp", "weight": 100.0, "stiffness": 200.0},
        "gripper": {"type": "posture", "joints": ["panda_finger_joint1"], "weight": 10.0, "stiffness": 400.0},
        "posture": {"type": "posture", "joints": ARM, "weight": 0.01, "stiffness": 20.0},
    },
}


def main() -> int:
    """Reach and grip; return 0 if all targets are met."""
    for finding in wbc.check(PANDA):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(PANDA)
    controller, dynamics = robot.controller, robot.controller.dynamics
    hand, gripper = controller.tasks["hand"], controller.tasks["gripper"]
    start = pin.XYZQUATToSE3(hand.position(dynamics))
    results, away, turned, gripped, apart, forecast = [], [], [], [], [], []

    def observe(robot: wbc.Simulation) -> None:
        robot.plant.forward()
        first, second = (robot.plant.data.joint(f"panda_finger_joint{i}").qpos.item() for i in (1, 2))
        apart.append(abs(first - second))
        forecast.append(np.linalg.norm(robot.result.v_dot - robot.plant.acceleration()))

    for move, turn, finger in REACHES:
        goal = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(np.array(turn)) @ start.rotation, start.translation + move))
        controller.set("hand", goal)
        controller.set("gripper", [finger])
        results += robot.run(1.4, observe)
        error = hand.error(dynamics, goal)
        away.append(np.linalg.norm(error[:3]))
        turned.append(np.linalg.norm(error[3:]))
        gripped.append(abs(gripper.position(dynamics)[0] - finger))
    share = max(np.max(np.abs(result.solution.tau) / controller.model.effort_limits) for result in results)
    largest = max(np.linalg.norm(result.v_dot) for result in results)
    targets = [
        ("position error of the tool", 1e3 * max(away), 0.5, "mm"),
        ("orientation error of the tool", max(turned), 0.002, "rad"),
        ("position error of the finger", 1e3 * max(gripped), 0.2, "mm"),
        ("difference of the fingers", 1e3 * max(apart), 0.01, "mm"),
        ("largest share of torque limits", share, 0.9, ""),
        ("accelerations, QP minus MuJoCo, share of the largest", max(forecast) / largest, 0.01, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.3g} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
