"""A humanoid lifts a box between its hands: the left one holds it fast, the right palm presses on its other side.

The box is a link of the robot, fixed to the left hand; the right palm is a `surface` contact against it, with a
smallest squeeze. In MuJoCo.
"""

import sys

import numpy as np
import pinocchio as pin

from wbc_controller.assembly.robot import make_model
from wbc_controller.core.references.changes import SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

MASS, HALF = 2.0, 0.14  # kg; half of the box's width, m: what is between the hands
SQUEEZE, FRICTION = 15.0, 0.6  # N; of the palm on the box
BOX = """
  <link name="box"><inertial><origin xyz="0 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <joint name="box_joint" type="fixed"><parent link="left_rubber_hand"/><child link="box"/>
    <origin xyz="{xyz}" rpy="{rpy}"/></joint>
</robot>"""


def numbers(values: np.ndarray) -> str:
    """Write as a URDF does."""
    return " ".join(f"{value:.12g}" for value in values)


def configuration() -> tuple[Settings, str]:
    """G1 with its forearms ahead of it, the box between its hands, and the URDF with the box in it."""
    values = load_settings(find_configuration("g1")).model_dump()
    robot = values["robot"]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for joint, angle in (("shoulder_pitch", 0.1), ("shoulder_roll", sign * 0.2), ("elbow", 0.2)):
            robot["posture"][robot["joints"].index(f"{side}_{joint}_joint")] = angle
    settings = Settings.model_validate(values)
    model = make_model(settings)
    data = model.pinocchio.createData()
    pin.framesForwardKinematics(model.pinocchio, data, model.configuration(model.posture))
    left, right = (data.oMf[model.pinocchio.getFrameId(f"{side}_rubber_hand")] for side in ("left", "right"))
    # The box upright between the hands, ahead of the wrists; the palm on its right side, the contact's z out of it.
    box = pin.SE3(np.eye(3), 0.5 * (left.translation + right.translation) + np.array([0.08, 0.0, 0.0]))
    palm = box * pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.0, -HALF, 0.0]))
    in_left, in_right = left.actInv(box), right.actInv(palm)
    text = BOX.format(mass=MASS, xyz=numbers(in_left.translation), rpy=numbers(pin.rpy.matrixToRpy(in_left.rotation)))
    values["contacts"]["palm"] = {
        "type": "surface", "frame": "right_rubber_hand", "against": "box", "half_length": 0.04, "half_width": 0.04,
        "translation": in_right.translation.tolist(), "rpy": pin.rpy.matrixToRpy(in_right.rotation).tolist(),
        "friction": FRICTION, "min_normal_force": SQUEEZE, "max_normal_force": 80.0,
    }  # fmt: skip
    values["tasks"]["box"] = {"type": "frame_pose", "frame": "box", "weight": 20.0, "setpoint_duration": 0.6}
    return Settings.model_validate(values), model.urdf[: model.urdf.rindex("</robot>")] + text


def main() -> int:
    """Lift the box, carry it aside, and turn it; 0 where all targets are met."""
    robot = Simulation(*configuration())
    dynamics, model, palm = robot.controller.dynamics, robot.controller.model, robot.controller.contacts["palm"]
    box = model.frame_id("box", "")
    robot.run(0.2)
    start = dynamics.placement(box).copy()
    at = start.actInv(palm.placement(dynamics)).translation
    slipped, pressed, used, errors = [], [], [], []

    def look(robot: Simulation) -> None:
        here = dynamics.placement(box).actInv(palm.placement(dynamics)).translation
        slipped.append(np.linalg.norm(here - at))
        pressed.append(robot.plant.contact_wrenches()["palm"][2])
        fx, fy, fz, *_ = robot.solution.forces["palm"]
        used.append(np.hypot(fx, fy) / (FRICTION * fz))

    turned = pin.utils.rotate("z", 0.15)
    for way, turn in (([0.0, 0.04, 0.08], np.eye(3)), ([0.0, 0.0, 0.04], turned)):
        goal = pin.SE3(turn @ start.rotation, start.translation + way)
        robot.apply(SetSetpoint("box", pin.SE3ToXYZQUAT(goal)))
        robot.run(0.7, look)
        errors.append(pin.log6(goal.actInv(dynamics.placement(box))).vector)
    smooth = np.convolve(pressed, np.full(25, 1.0 / 25.0), "valid")  # 50 ms: single corners of the palm come and go
    targets = [
        ("box off its references", 1e3 * max(np.abs(error[:3]).max() for error in errors), 0.0, 5.0, "mm"),
        ("turned off them", max(np.abs(error[3:]).max() for error in errors), 0.0, 0.02, "rad"),
        ("palm slipped", 1e3 * max(slipped), 0.0, 1.0, "mm"),
        ("smallest squeeze", min(smooth), 0.9 * SQUEEZE, 80.0, "N"),
        ("share of the friction used", max(used), 0.0, 1.01, ""),
        ("fallen", float(robot.plant.fallen), 0.0, 0.0, ""),
    ]
    for what, value, least, most, unit in targets:
        print(f"{what}: {value:.3f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
