"""A humanoid stands and sways on a slope of 20° without slip, in MuJoCo.

Only the ankle angles of the posture contain the slope.
"""

import sys

import numpy as np

import wbc_controller as wbc

SLOPE = np.radians(20.0)
SWAY = 0.03  # m
FRICTION = 0.7


def configuration() -> wbc.Config:
    """Return G1 on a floor that rises ahead of it."""
    bent = {"hip_pitch": -0.3398, "knee": 0.6, "ankle_pitch": -0.2602 - SLOPE}  # upright base, soles on the slope
    changes = {f"robot.posture.{side}_{joint}_joint": bent[joint] for side in ("left", "right") for joint in bent}
    floor = {"mock.floor_normal": [-np.sin(SLOPE), 0.0, np.cos(SLOPE)]}
    return wbc.load("g1").replace(changes | floor | {"tasks.com.setpoint_duration": 0.5})


def main() -> int:
    """Sway to both sides and up the slope; return 0 if all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    dynamics, contacts = robot.controller.dynamics, robot.controller.contacts
    start, slide, used, errors = np.array(dynamics.com), [], [], []
    robot.run(0.2)  # settling of the soles
    feet = {name: contact.points(dynamics) for name, contact in contacts.items()}

    def observe(robot: wbc.Simulation) -> None:
        slide.extend(np.abs(contacts[name].points(dynamics) - at).max() for name, at in feet.items())
        for fx, fy, fz, *_ in robot.plant.contact_wrenches().values():
            used.append(np.hypot(fx, fy) / (FRICTION * fz) if fz > 0.0 else 0.0)

    for way in ([0.0, SWAY, 0.0], [0.0, -SWAY, 0.0], [0.3 * SWAY, 0.0, -SWAY]):
        robot.controller.set("com", start + way)
        robot.run(0.6, observe)
        errors.append(np.linalg.norm(dynamics.com - start - way))
    targets = [
        ("slip of the soles", 1e3 * max(slide), 1.0, "mm"),
        ("error of the centre of mass", 1e3 * max(errors), 2.0, "mm"),
        ("share of the friction limit", max(used), 1.01, ""),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.2f} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
