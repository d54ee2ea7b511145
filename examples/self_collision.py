"""G1's hands are commanded through its torso, then through each other, in MuJoCo; the links keep their distance.

When the way is free again, the hands are where they are wanted.
"""

import sys

import numpy as np

from wbc_controller.assembly.preflight import check
from wbc_controller.core.limits import SelfCollisionLimit
from wbc_controller.core.references.changes import SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

MARGIN = 0.02  # m
HANDS = ("left_hand", "right_hand")


def configuration() -> Settings:
    """G1 with its hands' tasks on, and its links kept apart."""
    values = load_settings(find_configuration("g1")).model_dump()
    values["limits"]["self_collision"] = {
        "enabled": True,
        "margin": MARGIN,
        "visual": ["left_rubber_hand", "right_rubber_hand"],  # they have no collision elements
    }
    for hand in HANDS:
        values["tasks"][hand] |= {"enabled": True, "setpoint_duration": 0.3}
    return Settings.model_validate(values)


def main() -> int:
    """Command what is not possible, then what is; 0 where all targets are met."""
    settings = configuration()
    for finding in check(settings):
        print(f"{finding.subject}: {finding.text}")
    robot = Simulation(settings)
    dynamics, tasks = robot.controller.dynamics, robot.controller.tasks
    (limit,) = robot.controller.formulation.row_limits
    if not isinstance(limit, SelfCollisionLimit):
        raise TypeError(f"the limit is a {type(limit).__name__}")
    start = {hand: tasks[hand].rest(dynamics).position for hand in HANDS}
    least, held, blocked, errors = [], set(), [], []

    def look(robot: Simulation) -> None:
        held.update(name for name in robot.solution.binding if name.startswith("self_collision:"))
        if round(robot.time / robot.controller.formulation.period) % 10 == 0:
            distances = limit.distances(dynamics)
            least.append(min((distance, name) for name, distance in distances.items()))

    def command(seconds: float, **goals: np.ndarray) -> float:
        """Send both hands somewhere; how far the farther one is from there in the end, m."""
        robot.apply(*(SetSetpoint(hand, np.concatenate([at, start[hand][3:]])) for hand, at in goals.items()))
        robot.run(seconds, look)
        return max(float(np.linalg.norm(tasks[hand].rest(dynamics).position[:3] - at)) for hand, at in goals.items())

    left, right = (start[hand][:3] for hand in HANDS)
    inside, up = np.array([-0.1, 0.0, 0.0]), np.array([0.0, 0.0, 0.1])
    blocked.append(command(0.4, left_hand=right * [0, 0, 1] + inside + up, right_hand=left * [0, 0, 1] + inside + up))
    errors.append(command(0.7, left_hand=left, right_hand=right))
    blocked.append(command(0.4, left_hand=right, right_hand=left))
    errors.append(command(0.7, left_hand=left + up, right_hand=right + up))

    distance, name = min(least)
    print(f"nearest: {name.partition(':')[2]}; {len(held)} pairs were held")
    targets = [
        ("distance below the margin", max(0.0, 1e3 * (MARGIN - distance)), 0.0, "mm"),
        ("hands off their free goals", 1e3 * max(errors), 10.0, "mm"),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.2f} {unit} (at most {most:g})")
    print(f"hands off goals that were in the way: {1e3 * min(blocked):.0f} mm (at least 100)")
    return int(not (all(value <= most for _, value, most, _ in targets) and min(blocked) >= 0.1 and len(held) > 0))


if __name__ == "__main__":
    sys.exit(main())
