"""A humanoid grips a rail, leans beyond its support polygon, returns and releases the rail, in MuJoCo.

The grip is a `fixed` contact with a mask: free rotation about the rail.
"""

import sys

import numpy as np

import wbc_controller as wbc

OUT = 0.05  # distance ahead of the toes, m
GRIP = {
    "type": "fixed",
    "frame": "left_rubber_hand",
    "mask": [True, True, True, True, False, True],  # free rotation about the sideways rail
    "max_force": 150.0,
    "max_moment": 5.0,
    "enabled": False,
    "ramp": 0.1,
}
#: G1 with its hands in front, and a grip.
CONFIG = wbc.load("g1").replace({
    "robot.posture": {"left_shoulder_pitch_joint": -0.2, "right_shoulder_pitch_joint": -0.2},
    "contacts.grip": GRIP,
    "tasks.com": {"setpoint_duration": 0.9, "mask": [True, True, False]},
})  # fmt: skip


def main() -> int:
    """Grip, lean, return, release; return 0 if all targets are met."""
    robot = wbc.Simulation(CONFIG)
    controller, plant, dynamics = robot.controller, robot.plant, robot.controller.dynamics
    grip, soles = controller.contacts["grip"], [controller.contacts[name] for name in ("left_foot", "right_foot")]

    def ahead() -> float:
        """Return the distance of the centre of mass ahead of the soles, m."""
        return dynamics.com[0] - max(sole.points(dynamics)[:, 0].max() for sole in soles)

    results = robot.run(0.1)
    start = np.array(dynamics.com)
    plant.grip("grip", True)
    controller.enable("grip")
    controller.set("com", start + np.array([OUT - ahead(), 0.0, 0.0]))
    results += robot.run(1.2)
    lean, planned = ahead(), grip.basis @ robot.result.forces["grip"]
    plant.forward()
    off = np.linalg.norm(plant.contact_wrenches()["grip"] - planned)
    controller.set("com", start)
    results += robot.run(1.0)
    controller.disable("grip")
    results += robot.run(0.1)
    plant.grip("grip", False)
    results += robot.run(0.3)
    forces = np.abs([grip.basis @ result.forces["grip"] for result in results if "grip" in result.forces])
    jumps = np.abs(np.diff([result.solution.tau for result in results], axis=0)) / controller.model.effort_limits
    print(f"wrench of the grip while leaning: {np.array2string(planned, precision=1)} N, N·m")
    targets = [
        ("centre of mass outside the soles", 1e3 * lean, 1e3 * (OUT - 0.005), np.inf, "mm"),
        ("wrench of the grip, QP minus MuJoCo", off, 0.0, 3.0, "N, N·m"),
        ("largest force along an axis", forces[:, :3].max(), 1.0, GRIP["max_force"], "N"),
        ("largest moment about an axis", forces[:, 3:].max(), 0.0, GRIP["max_moment"] + 1e-6, "N·m"),
        ("largest force or moment at release", forces[-1].max(), 0.0, 3.1, "N, N·m"),
        ("largest torque step, share of the effort limit", jumps.max(), 0.0, 0.2 + 1e-9, ""),
        (
            "position error of the centre of mass at the end",
            1e3 * np.linalg.norm((dynamics.com - start)[:2]),
            0.0,
            3.0,
            "mm",
        ),
        ("fallen", float(plant.fallen), 0.0, 0.0, ""),
    ]
    for name, value, least, most, unit in targets:
        print(f"{name}: {value:.2f} {unit} ({least:g} to {most:g})")
    return int(not all(least <= value <= most for _, value, least, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
