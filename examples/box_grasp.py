"""A humanoid lifts a box between its hands: the left one holds it fast, the right palm presses on its other side.

The box is a link of the robot, fixed to the left hand; the right palm is a `surface` contact against it, with a
smallest squeeze. In MuJoCo.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

MASS, HALF = 2.0, 0.14  # kg; half of the box's width, m: what is between the hands
SQUEEZE, FRICTION = 15.0, 0.6  # N; of the palm on the box
BOX = """
  <link name="box"><inertial><origin xyz="0 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <joint name="box_joint" type="fixed"><parent link="left_rubber_hand"/><child link="box"/>
    <origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>
</robot>"""


def configuration() -> wbc.Config:
    """G1 with its forearms ahead of it, the box between its hands, and the URDF with the box in it."""
    g1 = wbc.load("g1").replace({
        "robot.posture.left_shoulder_pitch_joint": 0.1, "robot.posture.left_elbow_joint": 0.2,
        "robot.posture.right_shoulder_pitch_joint": 0.1, "robot.posture.right_elbow_joint": 0.2,
    })  # fmt: skip
    controller = wbc.Controller(g1)  # its dynamics are those of the nominal posture before the first step
    hands = (controller.tasks[name].position(controller.dynamics) for name in ("left_hand", "right_hand"))
    left, right = map(pin.XYZQUATToSE3, hands)
    # The box upright between the hands, ahead of the wrists; the palm on its right side, the contact's z out of it.
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
    """Lift the box, carry it aside, and turn it; 0 where all targets are met."""
    robot = wbc.Simulation(configuration())
    dynamics, box, palm = robot.controller.dynamics, robot.controller.tasks["box"], robot.controller.contacts["palm"]
    robot.run(0.2)
    start, at = pin.XYZQUATToSE3(box.position(dynamics)), palm.pose(dynamics).translation
    results, slipped, pressed, off, turned = [], [], [], [], []

    def look(robot: wbc.Simulation) -> None:
        slipped.append(np.linalg.norm(palm.pose(dynamics).translation - at))
        pressed.append(robot.plant.contact_wrenches()["palm"][2])

    for way, turn in (([0.0, 0.04, 0.08], 0.0), ([0.0, 0.0, 0.04], 0.15)):
        goal = pin.SE3ToXYZQUAT(pin.SE3(pin.utils.rotate("z", turn) @ start.rotation, start.translation + way))
        robot.controller.set("box", goal)
        results += robot.run(0.7, look)
        error = box.error(dynamics, goal)
        off.append(np.linalg.norm(error[:3]))
        turned.append(np.linalg.norm(error[3:]))
    smooth = np.convolve(pressed, np.full(25, 1.0 / 25.0), "valid")  # 50 ms: single corners of the palm come and go
    targets = [
        ("box off its references", 1e3 * max(off), 0.0, 5.0, "mm"),
        ("turned off them", max(turned), 0.0, 0.02, "rad"),
        ("palm slipped", 1e3 * max(slipped), 0.0, 1.0, "mm"),
        ("smallest squeeze", min(smooth), 0.9 * SQUEEZE, 80.0, "N"),
        ("share of the friction used", max(result.friction_used()["palm"] for result in results), 0.0, 1.01, ""),
        ("fallen", float(robot.plant.fallen), 0.0, 0.0, ""),
    ]
    for what, value, least, most, unit in targets:
        print(f"{what}: {value:.3f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
