"""A humanoid stands and sways on a slope of 20°, in MuJoCo, without sliding.

The soles say where the surface is, so that nothing but the posture knows of the slope: the ankles are bent by its
angle.
"""

import sys

import numpy as np

from wbc_controller.assembly.preflight import check
from wbc_controller.core.references.changes import SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

SLOPE = np.radians(20.0)
SWAY = 0.03  # m
FRICTION = 0.7


def configuration() -> Settings:
    """G1 with bent ankles, leaning into a floor that rises ahead of it."""
    values = load_settings(find_configuration("g1")).model_dump()
    robot = values["robot"]
    for joint, angle in (("hip_pitch", -0.07), ("knee", 0.0), ("ankle_pitch", 0.07 - SLOPE)):
        for side in ("left", "right"):
            robot["posture"][robot["joints"].index(f"{side}_{joint}_joint")] += angle
    values["mock"]["floor_normal"] = [-np.sin(SLOPE), 0.0, np.cos(SLOPE)]
    values["tasks"]["com"]["setpoint_duration"] = 0.5
    return Settings.model_validate(values)


def main() -> int:
    """Sway to both sides and up the slope; 0 where all targets are met."""
    settings = configuration()
    for finding in check(settings):
        print(f"{finding.subject}: {finding.text}")
    robot = Simulation(settings)
    dynamics, contacts = robot.controller.dynamics, robot.controller.contacts
    start = np.array(dynamics.com)
    feet = {name: contact.points(dynamics) for name, contact in contacts.items()}
    slide, used, errors = [], [], []

    def look(robot: Simulation) -> None:
        slide.append(max(np.abs(contacts[name].points(dynamics) - at).max() for name, at in feet.items()))
        for fx, fy, fz, *_ in robot.plant.contact_wrenches().values():
            used.append(np.hypot(fx, fy) / (FRICTION * fz))

    robot.run(0.2)  # until the soles have settled
    feet = {name: contact.points(dynamics) for name, contact in contacts.items()}
    for way in ([0.0, SWAY, 0.0], [0.0, -SWAY, 0.0], [0.3 * SWAY, 0.0, -SWAY]):
        robot.apply(SetSetpoint("com", start + way))
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
