"""A humanoid bends to reach a point, and its balance does not give: strict priorities, and a tolerance on the highest.

The centre of mass may be anywhere within 3 cm; the hand comes next; what both leave open belongs to the posture. With
the same weights on one level, the hand takes the centre of mass along, past the toes. In MuJoCo.
"""

import sys

import numpy as np

from wbc_controller.core.references.changes import EnableTask, SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

TOLERANCE = 0.03  # m, forward and sideways
FAR = 0.45  # m, ahead of where the hand is


def configuration(*, strict: bool) -> Settings:
    """G1 with three levels, or with the same tasks and weights on one."""
    values = load_settings(find_configuration("g1")).model_dump()
    tasks = values["tasks"]
    tasks["left_hand"] = {
        "type": "frame_position", "frame": "left_rubber_hand", "weight": 50.0, "stiffness": 40.0, "enabled": False,
    }  # fmt: skip
    tasks["com"] |= {"stiffness": 40.0, "damping": None}
    # What settles the rest has to settle it well: with a weak posture below a strict hand, the arms and legs swing.
    for name, weight in {"pelvis": 0.5, "torso": 0.5, "posture": 0.1}.items():
        tasks[name]["weight"] = weight
    if strict:
        tasks["com"] |= {"tolerance": [TOLERANCE, TOLERANCE, 0.2]}
        tasks["left_hand"]["level"] = 1
        for name in ("pelvis", "torso", "posture", "right_hand"):
            tasks[name]["level"] = 2
    return Settings.model_validate(values)


def reach(seconds: float, *, strict: bool) -> tuple[float, float, Simulation]:
    """Reach for a while; gives how far hand and centre of mass went ahead, m."""
    robot = Simulation(configuration(strict=strict))
    dynamics = robot.controller.dynamics
    hand = robot.controller.tasks["left_hand"]
    robot.run(0.1)
    start, com = hand.position(dynamics), np.array(dynamics.com)
    robot.apply(EnableTask("left_hand", True), SetSetpoint("left_hand", start + np.array([FAR, 0.0, 0.0])))
    robot.run(seconds)
    return float((hand.position(dynamics) - start)[0]), float((dynamics.com - com)[0]), robot


def main() -> int:
    """Reach with priorities and without; 0 where all targets are met."""
    hand, com, robot = reach(2.0, strict=True)
    for level in robot.solution.levels:
        print(f"{', '.join(level.tasks)}: cost {level.cost:.3g}, {level.iterations} iterations")
    _, weighted_com, _ = reach(1.5, strict=False)
    targets = [
        ("centre of mass ahead, with levels", 1e3 * com, 0.0, 1e3 * TOLERANCE + 2.0, "mm"),
        ("hand ahead, with levels", 1e3 * hand, 1e3 * FAR - 5.0, 1e3 * FAR + 5.0, "mm"),
        ("centre of mass ahead, with weights", 1e3 * weighted_com, 90.0, np.inf, "mm"),
        ("fallen, with levels", float(robot.plant.fallen), 0.0, 0.0, ""),
    ]
    for what, value, least, most, unit in targets:
        print(f"{what}: {value:.1f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
