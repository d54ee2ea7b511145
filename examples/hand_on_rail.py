"""A humanoid takes hold of a rail, leans out further than its feet alone could carry it, comes back and lets go.

The grip holds the hand in place and lets it turn about the rail: a `fixed` contact with a mask. In MuJoCo.
"""

import sys

import numpy as np

from wbc_controller.assembly.preflight import support_margin
from wbc_controller.core.references.changes import EnableContact, SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

OUT = 0.05  # m, ahead of the toes
GRIP = {
    "type": "fixed",
    "frame": "left_rubber_hand",
    "mask": [True, True, True, True, False, True],  # free about the rail, which runs sideways
    "max_force": 150.0,
    "max_moment": 5.0,
    "enabled": False,
    "ramp": 0.1,
}


def configuration() -> Settings:
    """G1 with its elbows bent more, so that the hands are ahead of it, and a grip."""
    values = load_settings(find_configuration("g1")).model_dump()
    robot = values["robot"]
    for side in ("left", "right"):
        robot["posture"][robot["joints"].index(f"{side}_shoulder_pitch_joint")] = -0.2
    values["contacts"]["grip"] = GRIP
    values["tasks"]["com"] |= {"setpoint_duration": 0.9, "mask": [True, True, False]}
    return Settings.model_validate(values)


def main() -> int:
    """Grip, lean, come back, let go; 0 where all targets are met."""
    robot = Simulation(configuration())
    dynamics, contacts, plant = robot.controller.dynamics, robot.controller.contacts, robot.plant
    jumps, forces, before = [], [], [None]

    def look(robot: Simulation) -> None:
        tau = robot.solution.tau
        if before[0] is not None:
            jumps.append(np.abs((tau - before[0]) / robot.controller.model.effort_limits).max())
        before[0] = tau
        grip = np.array(robot.solution.forces.get("grip", np.zeros(5)))
        forces.append((np.abs(grip[:3]).max(), np.abs(grip[3:]).max()))

    def margin() -> float:
        soles = np.vstack([contacts[name].points(dynamics) for name in ("left_foot", "right_foot")])
        return support_margin(soles[:, :2], dynamics.com[:2])

    robot.run(0.1, look)
    start, toes = np.array(dynamics.com), max(contacts["left_foot"].points(dynamics)[:, 0])
    plant.grip("grip", True)
    robot.apply(EnableContact("grip", True), SetSetpoint("com", np.array([toes + OUT, *start[1:]])))
    robot.run(1.2, look)
    lean, planned = margin(), contacts["grip"].basis @ robot.solution.forces["grip"]
    plant.forward()
    off = np.linalg.norm(plant.contact_wrenches()["grip"] - planned)
    robot.apply(SetSetpoint("com", start))
    robot.run(1.0, look)
    robot.apply(EnableContact("grip", False))
    robot.run(0.1, look)
    last = robot.solution.forces["grip"]
    plant.grip("grip", False)
    robot.run(0.3, look)
    print(f"leaning, the grip bears {np.array2string(planned, precision=1)} N, N·m")
    targets = [
        ("centre of mass outside the soles", 1e3 * -lean, 1e3 * (OUT - 0.005), np.inf, "mm"),
        ("force of the grip, QP against MuJoCo", off, 0.0, 3.0, "N, N·m"),
        ("largest force along an axis", max(force for force, _ in forces), 1.0, GRIP["max_force"], "N"),
        ("largest moment about an axis", max(moment for _, moment in forces), 0.0, GRIP["max_moment"] + 1e-6, "N·m"),
        ("force at letting go", np.abs(last).max(), 0.0, 3.1, "N, N·m"),
        ("largest torque step, of the effort limit", max(jumps), 0.0, 0.2 + 1e-9, ""),
        ("centre of mass off its start", 1e3 * np.linalg.norm((dynamics.com - start)[:2]), 0.0, 3.0, "mm"),
        ("fallen", float(plant.fallen), 0.0, 0.0, ""),
    ]
    for what, value, least, most, unit in targets:
        print(f"{what}: {value:.2f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
