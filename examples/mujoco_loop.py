"""Your own MuJoCo loop: Unitree A1 (not shipped) squats on the collision shapes of its URDF."""

from pathlib import Path

import mujoco
import numpy as np

import wbc_controller as wbc

controller = wbc.Controller(Path(__file__).with_name("a1.yaml"))
spec = mujoco.MjSpec.from_string(controller.model.urdf)
spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
spec.body(controller.model.base_link).add_freejoint()
data = mujoco.MjData(scene := spec.compile())
robot = wbc.MujocoInterface(controller.model, scene)
robot.place(data, controller.stance())
controller.reset(*robot.state(data))
start = np.array(controller.dynamics.com)
for height in (0.0, -0.1, 0.0):  # m, relative to the start
    controller.set("com", start + np.array([0.0, 0.0, height]))
    for _ in range(750):
        robot.apply(data, controller.step(*robot.state(data), data.time).tau)
        mujoco.mj_step(scene, data)
    print(f"asked {1e3 * height:.0f} mm, centre of mass at {1e3 * (controller.dynamics.com - start)[2]:.1f} mm")
