"""A humanoid reaches for a point with strict priorities, in MuJoCo.

Level 0: centre of mass within a tolerance of 3 cm; level 1: hand; level 2: posture. With the same weights on one level
the centre of mass moves beyond the toes.
"""

import sys

import numpy as np

import wbc_controller as wbc

TOLERANCE = 0.03  # m, forward and sideways
FAR = 0.45  # forward distance of the goal, m
#: G1 with a hand task. The lower tasks need enough weight, otherwise arms and legs swing.
WEIGHTED = wbc.load("g1").replace({
    "tasks.com": {"stiffness": 40.0, "damping": None},
    "tasks.left_hand": {"type": "frame_position", "weight": 50.0, "stiffness": 40.0},
    "tasks.pelvis.weight": 0.5, "tasks.torso.weight": 0.5, "tasks.posture.weight": 0.1,
})  # fmt: skip
#: Same tasks and weights on three levels.
STRICT = WEIGHTED.replace({
    "tasks.com.tolerance": [TOLERANCE, TOLERANCE, 0.2],
    "tasks.left_hand.level": 1,
    **{f"tasks.{name}.level": 2 for name in ("pelvis", "torso", "posture", "right_hand")},
})  # fmt: skip


def reach(config: wbc.Config, seconds: float) -> tuple[float, float, wbc.Simulation]:
    """Reach; return forward displacements of hand and centre of mass, m."""
    robot = wbc.Simulation(config)
    dynamics, hand = robot.controller.dynamics, robot.controller.tasks["left_hand"]
    robot.run(0.1)
    start, com = hand.position(dynamics), np.array(dynamics.com)
    robot.controller.enable("left_hand")
    robot.controller.set("left_hand", start + np.array([FAR, 0.0, 0.0]))
    robot.run(seconds)
    return (hand.position(dynamics) - start)[0], (dynamics.com - com)[0], robot


def main() -> int:
    """Reach with and without priorities; return 0 if all targets are met."""
    hand, com, robot = reach(STRICT, 2.0)
    for level in robot.result.solution.levels:
        print(f"{', '.join(level.tasks)}: cost {level.cost:.3g}, {level.iterations} iterations")
    _, weighted_com, _ = reach(WEIGHTED, 1.5)
    targets = [
        ("centre of mass ahead, with levels", 1e3 * com, 0.0, 1e3 * TOLERANCE + 2.0, "mm"),
        ("hand ahead, with levels", 1e3 * hand, 1e3 * FAR - 5.0, 1e3 * FAR + 5.0, "mm"),
        ("centre of mass ahead, with weights", 1e3 * weighted_com, 90.0, np.inf, "mm"),
        ("fallen, with levels", float(robot.plant.fallen), 0.0, 0.0, ""),
    ]
    for name, value, least, most, unit in targets:
        print(f"{name}: {value:.1f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
