"""An elbow of G1 is flung at a goal beyond its stop, in MuJoCo; every limit that is in its way holds.

Its position, velocity and acceleration, its torque, the torque's rate, and what the motor has left at its speed.
"""

import sys

import numpy as np

from wbc_controller.core.references.changes import SetSetpoint
from wbc_controller.mock.simulation import Simulation
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

JOINT = "left_elbow_joint"
CORNER, NO_LOAD = 0.5, 3.6  # rad/s


def configuration() -> Settings:
    """G1 with a task that flings its elbow, and tight limits."""
    values = load_settings(find_configuration("g1")).model_dump()
    values["tasks"]["fling"] = {
        "type": "posture", "joints": [JOINT], "weight": 1.0, "stiffness": 400.0, "setpoint_duration": 0.0,
    }  # fmt: skip
    values["limits"] |= {"velocity_scale": 0.1, "acceleration": 60.0, "torque_rate": 40.0}
    values["limits"]["torque_speed"] = {"enabled": True, "actuators": {JOINT: {"corner": CORNER, "no_load": NO_LOAD}}}
    return Settings.model_validate(values)


def main() -> int:
    """Fling the elbow to and fro; 0 where every limit bound and held."""
    settings = configuration()
    robot = Simulation(settings)
    model, limits = robot.controller.model, settings.limits
    i = model.joints.index(JOINT)
    period, effort = robot.controller.formulation.period, model.effort_limits[i]
    stop = model.position_upper[i] - limits.position_margin
    fastest = limits.velocity_scale * model.velocity_limits[i]
    visited, bound = [], set()

    def look(robot: Simulation) -> None:
        q, v = robot.plant.state()
        solution = robot.solution
        visited.append((q[model.q_index[i]], v[model.v_index[i]], solution.v_dot[model.v_index[i]], solution.tau[i]))
        bound.update(name for name in solution.binding if JOINT in name)

    for goal, seconds in ((-0.5, 0.4), (model.position_upper[i] + 1.0, 1.1), (0.5, 0.2)):
        robot.apply(SetSetpoint("fling", np.array([goal])))
        robot.run(seconds, look)
    q, v, v_dot, tau = np.array(visited).T
    rate = np.abs(np.diff(tau)).max() / period / effort
    left = effort * np.clip((NO_LOAD - np.abs(v)) / (NO_LOAD - CORNER), 0.0, 1.0)
    targets = [
        ("position beyond the stop", q.max() - stop, 1.0e-3, "rad"),
        ("speed beyond the fastest", np.abs(v).max() - fastest, 0.02, "rad/s"),
        ("acceleration beyond the largest", np.abs(v_dot).max() - limits.acceleration, 1.0e-4, "rad/s²"),
        ("torque beyond the limit", np.abs(tau).max() - effort, 1.0e-4, "N·m"),
        ("torque beyond what is left at the speed", (tau * np.sign(v) - left).max(), 1.0e-4, "N·m"),
        ("torque rate beyond the largest", rate - limits.torque_rate, 1.0e-2, "1/s"),
        ("short of the stop", stop - q.max(), 5.0e-3, "rad"),
        ("short of the fastest", fastest - np.abs(v).max(), 0.2, "rad/s"),
        ("short of what is left at the speed", (left - tau * np.sign(v)).min(), 0.1, "N·m"),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.4g} {unit} (at most {most:g})")
    print(f"bound: {', '.join(sorted(bound))}")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
