"""G1's hands are commanded into its torso, and through each other, in MuJoCo; the links keep their distance."""

import sys

import numpy as np

import wbc_controller as wbc

MARGIN = 0.02  # m
HANDS = ("left_hand", "right_hand")


def configuration() -> wbc.Config:
    """Return G1 with enabled hand tasks and self-collision avoidance."""
    visual = ["left_rubber_hand", "right_rubber_hand"]  # without collision elements
    return wbc.load("g1").replace(
        {"limits.self_collision": {"enabled": True, "margin": MARGIN, "visual": visual}}
        | {f"tasks.{hand}": {"enabled": True, "setpoint_duration": 0.3} for hand in HANDS}
    )


def main() -> int:
    """Command unreachable and reachable goals; return 0 if all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    dynamics, tasks = robot.controller.dynamics, [robot.controller.tasks[hand] for hand in HANDS]
    (limit,) = robot.controller.qp.formulation.row_limits
    start = [task.position(dynamics) for task in tasks]
    nearest, held = [], set()

    def command(seconds: float, *goals: np.ndarray) -> float:
        """Command goals of both hands; return the largest error at the end, m."""
        for task, at, pose in zip(tasks, goals, start, strict=True):
            robot.controller.set(task.name, [*at, *pose[3:]])
        for _ in range(round(seconds / 0.02)):
            results = robot.run(0.02)
            held.update(name for each in results for name in each.binding if name.startswith("self_collision:"))
            nearest.append(min((distance, name) for name, distance in limit.distances(dynamics).items()))
        return max(np.linalg.norm(task.position(dynamics)[:3] - at) for task, at in zip(tasks, goals, strict=True))

    left, right = (pose[:3] for pose in start)
    inside, up = np.array([-0.1, 0.0, left[2] + 0.1]), np.array([0.0, 0.0, 0.1])
    blocked = [command(0.4, inside, inside)]
    errors = [command(0.7, left, right)]
    blocked.append(command(0.4, right, left))
    errors.append(command(0.7, left + up, right + up))

    distance, name = min(nearest)
    print(f"nearest pair: {name.partition(':')[2]}; {len(held)} pairs were binding")
    targets = [
        ("distance below the margin", max(0.0, 1e3 * (MARGIN - distance)), 0.0, "mm"),
        ("error at reachable goals", 1e3 * max(errors), 10.0, "mm"),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.2f} {unit} (at most {most:g})")
    print(f"error at unreachable goals: {1e3 * min(blocked):.0f} mm (at least 100)")
    return int(not (all(value <= most for _, value, most, _ in targets) and min(blocked) >= 0.1 and len(held) > 0))


if __name__ == "__main__":
    sys.exit(main())
