"""User-defined task and limit: G1 keeps a tray on its hand level, and its head below a beam.

A task is a quantity x(q) with Jacobian and drift J̇v. A limit consists of rows lower ≤ G v̇ ≤ upper. `Simulation` and
`Controller` call both classes with the robot's model.
"""

import sys

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

HAND, HEAD = "left_rubber_hand", "torso_link"
ROOM, HORIZON = 0.02, 0.1  # height of the beam above the torso's start, m; braking time, s
AXES = pin.LOCAL_WORLD_ALIGNED


class LevelTray(wbc.MotionTask):
    """Height difference of two points on the hand, 20 cm apart, (1,) in m."""

    size = 1
    weight = 20.0

    def __init__(self, model: wbc.RobotModel) -> None:
        super().__init__("tray", [True], stiffness=200.0)
        self.frame = model.frame_id(HAND, "tray")

    def arm(self, dynamics: wbc.Dynamics) -> np.ndarray:
        """Return the vector between the points, world axes, (3,)."""
        return dynamics.placement(self.frame).rotation @ [0.2, 0.0, 0.0]

    def position(self, dynamics: wbc.Dynamics) -> np.ndarray:
        """Return the height difference, (1,) in m."""
        return self.arm(dynamics)[2:]

    def velocity(self, dynamics: wbc.Dynamics) -> np.ndarray:
        """Return its rate, (1,) in m/s."""
        return np.cross(dynamics.velocity(self.frame, AXES)[3:], self.arm(dynamics))[2:]

    def error(self, dynamics: wbc.Dynamics, position: np.ndarray) -> np.ndarray:
        """Return the error from a reference, (1,) in m."""
        return position - self.position(dynamics)

    def jacobian(self, dynamics: wbc.Dynamics) -> np.ndarray:
        """Return J, (1, nv)."""
        return -(pin.skew(self.arm(dynamics)) @ dynamics.jacobian(self.frame, AXES)[3:])[2:]

    def drift(self, dynamics: wbc.Dynamics) -> np.ndarray:
        """Return J̇v, (1,) in m/s²."""
        omega, arm = dynamics.velocity(self.frame, AXES)[3:], self.arm(dynamics)
        return (np.cross(dynamics.drift_world(self.frame)[3:], arm) + np.cross(omega, np.cross(omega, arm)))[2:]


class Beam(wbc.RowLimit):
    """Torso below a beam: z̈ ≤ (room - 2 T ż) / T², so that the room stays positive."""

    names, kind, unit = ("beam:torso",), "beam", "m/s²"

    def __init__(self, model: wbc.RobotModel) -> None:
        self.frame = model.frame_id(HEAD, "beam")
        self.height = np.inf  # set after the start

    def fill(self, dynamics, period, rows, lower, upper) -> None:
        """Write G, lower and upper."""
        rows[:] = dynamics.jacobian(self.frame, AXES)[2]
        room = self.height - dynamics.placement(self.frame).translation[2]
        speed = dynamics.velocity(self.frame, AXES)[2]
        lower[:] = -np.inf
        upper[:] = (room - 2.0 * HORIZON * speed) / HORIZON**2 - dynamics.drift_world(self.frame)[2]


def main() -> int:
    """Sway and rise against the beam; return 0 if both targets are met."""
    config = wbc.load("g1").replace({"robot.posture.left_elbow_joint": 0.2, "tasks.com.setpoint_duration": 0.5})
    robot = wbc.Simulation(config, tasks=[LevelTray], limits=[Beam])
    controller, beam = robot.controller, robot.controller.limits["beam"]
    torso, start = beam.frame, np.array(controller.dynamics.com)
    beam.height = controller.dynamics.placement(torso).translation[2] + ROOM
    controller.set("tray", [0.0])
    results, heights = [], []
    for way in ([0.02, 0.03, -0.06], [0.0, -0.03, 0.0], [0.0, 0.0, 0.04]):
        controller.set("com", start + way)
        results += robot.run(0.8, lambda robot: heights.append(controller.dynamics.placement(torso).translation[2]))
    print(results[-1])
    tilt, over = max(each.task_errors["tray"] for each in results[400:]), max(heights) - beam.height
    bound = "beam:torso" in results[-1].binding
    print(f"height difference of the tray: {1e3 * tilt:.2f} mm in 20 cm (at most 2)")
    print(f"torso above the beam: {1e3 * over:.2f} mm (at most 0.1); beam binding: {bound}")
    return int(not (tilt < 2e-3 and over < 1e-4 and bound))


if __name__ == "__main__":
    sys.exit(main())
