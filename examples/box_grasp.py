"""A humanoid lifts a box between its hands, in MuJoCo.

The box is a link fixed to the left hand. The right palm is a `surface` contact against it with a smallest force.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

MASS, HALF = 2.0, 0.14  # mass, kg, and half width, m, of the box
SQUEEZE, FRICTION = 15.0, 0.6  # smallest force, N, and friction of the palm
BOX = """
  <link name="box"><inertial><origin xyz="0 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <joint name="box_joint" type="fixed"><parent link="left_rubber_hand"/><child link="box"/>
    <origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>
</robot>"""


def configuration() -> wbc.Config:
    """Return G1 with a box between its hands."""
    g1 = wbc.load("g1").replace({
        "robot.posture.left_shoulder_pitch_joint": 0.1, "robot.posture.left_elbow_joint": 0.2,
        "robot.posture.right_shoulder_pitch_joint": 0.1, "robot.posture.right_elbow_joint": 0.2,
    })  # fmt: skip
    controller = wbc.Controller(g1)  # dynamics in the nominal posture before the first step
    hands = (controller.tasks[name].position(controller.dynamics) for name in ("left_hand", "right_hand"))
    left, right = map(pin.XYZQUATToSE3, hands)
    # Upright box between the hands, palm on its right side with outward z axis.
    box = pin.SE3(np.eye(3), 0.5 * (left.translation + right.translation) + np.array([0.08, 0.0, 0.0]))
    palm = box * pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.0, -HALF, 0.0]))
    in_left, in_right = left.actInv(box), right.actInv(palm)
    text = BOX.format(mass=MASS, at=in_left.translation, rpy=pin.rpy.matrixToRpy(in_left.rotation))
    changes = {
        "contacts.palm": {
            "type": "surface", "frame": "right_rubber_hand", "against": "box", "half_length": 0.04, "half_width": 0.04,
            "translation": in_right.translation, "rpy": pin.rpy.matrixToRpy(in_right.rotation),
            "friction": FRICTION, "min_normal_force": SQUEEZE, "max_normal_force": 80.0,
        },
        "tasks.box": {"type": "frame_pose", "frame": "box", "weight": 20.0, "setpoint_duration": 0.6},
    }  # fmt: skip
    return g1.replace(changes, urdf=controller.model.urdf.replace("</robot>", text))


def main() -> int:
    """Lift, move and rotate the box; return 0 if all targets are met."""
    robot = wbc.Simulation(configuration())
    dynamics, box, palm = robot.controller.dynamics, robot.controller.tasks["box"], robot.controller.contacts["palm"]
    robot.run(0.2)
    start, at = pin.XYZQUATToSE3(box.position(dynamics)), palm.pose(dynamics).translation
    results, slipped, pressed, off, turned = [], [], [], [], []

    def observe(robot: wbc.Simulation) -> None:
        slipped.append(np.linalg.norm(palm.pose(dynamics).translation - at))
        pressed.append(robot.plant.contact_wrenches()["palm"][2])

    for way, turn in (([0.0, 0.04, 0.08], 0.0), ([0.0, 0.0, 0.04], 0.15)):
        goal = pin.SE3ToXYZQUAT(pin.SE3(pin.utils.rotate("z", turn) @ start.rotation, start.translation + way))
        robot.controller.set("box", goal)
        results += robot.run(0.7, observe)
        error = box.error(dynamics, goal)
        off.append(np.linalg.norm(error[:3]))
        turned.append(np.linalg.norm(error[3:]))
    smooth = np.convolve(pressed, np.full(25, 1.0 / 25.0), "valid")  # mean over 50 ms
    targets = [
        ("position error of the box", 1e3 * max(off), 0.0, 5.0, "mm"),
        ("orientation error of the box", max(turned), 0.0, 0.02, "rad"),
        ("slip of the palm", 1e3 * max(slipped), 0.0, 1.0, "mm"),
        ("smallest force of the palm", min(smooth), 0.9 * SQUEEZE, 80.0, "N"),
        ("share of the friction limit", max(result.friction_used()["palm"] for result in results), 0.0, 1.01, ""),
        ("fallen", float(robot.plant.fallen), 0.0, 0.0, ""),
    ]
    for name, value, least, most, unit in targets:
        print(f"{name}: {value:.3f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
