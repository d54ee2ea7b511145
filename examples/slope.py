"""A humanoid stands and sways on a slope of 20°, in MuJoCo, without sliding.

The soles say where the surface is, so that nothing but the posture knows of the slope: the ankles are bent by its
angle.
"""

import sys

import numpy as np

import wbc_controller as wbc

SLOPE = np.radians(20.0)
SWAY = 0.03  # m
FRICTION = 0.7


def configuration() -> wbc.Config:
    """G1 with bent ankles, leaning into a floor that rises ahead of it."""
    bent = {"hip_pitch": -0.3398, "knee": 0.6, "ankle_pitch": -0.2602 - SLOPE}  # the base upright, the soles along it
    changes = {f"robot.posture.{side}_{joint}_joint": bent[joint] for side in ("left", "right") for joint in bent}
    floor = {"mock.floor_normal": [-np.sin(SLOPE), 0.0, np.cos(SLOPE)]}
    return wbc.load("g1").replace(changes | floor | {"tasks.com.setpoint_duration": 0.5})


def main() -> int:
    """Sway to both sides and up the slope; 0 where all targets are met."""
    config = configuration()
    for finding in wbc.check(config):
        print(f"{finding.subject}: {finding.text}")
    robot = wbc.Simulation(config)
    dynamics, contacts = robot.controller.dynamics, robot.controller.contacts
    start, slide, used, errors = np.array(dynamics.com), [], [], []
    robot.run(0.2)  # until the soles have settled
    feet = {name: contact.points(dynamics) for name, contact in contacts.items()}

    def look(robot: wbc.Simulation) -> None:
        slide.extend(np.abs(contacts[name].points(dynamics) - at).max() for name, at in feet.items())
        for fx, fy, fz, *_ in robot.plant.contact_wrenches().values():
            used.append(np.hypot(fx, fy) / (FRICTION * fz) if fz > 0.0 else 0.0)  # one foot may bear all

    for way in ([0.0, SWAY, 0.0], [0.0, -SWAY, 0.0], [0.3 * SWAY, 0.0, -SWAY]):
        robot.controller.set("com", start + way)
        robot.run(0.6, look)
        errors.append(np.linalg.norm(dynamics.com - start - way))
    targets = [
        ("soles slid", 1e3 * max(slide), 1.0, "mm"),
        ("centre of mass off its references", 1e3 * max(errors), 2.0, "mm"),
        ("share of the friction used", max(used), 1.01, ""),
        ("fallen", float(robot.plant.fallen), 0.5, ""),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.2f} {unit} (at most {most:g})")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
