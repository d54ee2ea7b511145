"""An elbow of G1 is flung at a goal beyond its stop, in MuJoCo; every limit that is in its way holds.

Its position, velocity and acceleration, its torque, the torque's rate, and what the motor has left at its speed.
"""

import sys

import numpy as np

import wbc_controller as wbc

JOINT = "left_elbow_joint"
CORNER, NO_LOAD = 0.5, 3.6  # rad/s
FASTEST, ACCELERATION, TORQUE_RATE = 0.1, 60.0, 40.0  # share of the velocity limit, rad/s², effort limits per second


def configuration() -> wbc.Config:
    """G1 with a task that flings its elbow, and tight limits."""
    return wbc.load("g1").replace({
        "tasks.fling": {"type": "posture", "joints": [JOINT], "stiffness": 400.0, "setpoint_duration": 0.0},
        "limits": {"velocity_scale": FASTEST, "acceleration": ACCELERATION, "torque_rate": TORQUE_RATE},
        "limits.torque_speed": {"enabled": True, "actuators": {JOINT: {"corner": CORNER, "no_load": NO_LOAD}}},
    })  # fmt: skip


def main() -> int:
    """Fling the elbow to and fro; 0 where every limit bound and held."""
    robot, results = wbc.Simulation(configuration()), []
    model = robot.controller.model
    i = model.joints.index(JOINT)
    effort, stop = model.effort_limits[i], model.position_upper[i] - robot.controller.config["limits.position_margin"]
    fastest = FASTEST * model.velocity_limits[i]
    for goal, seconds in ((-0.5, 0.4), (model.position_upper[i] + 1.0, 1.1), (0.5, 0.2)):
        robot.controller.set("fling", {JOINT: goal})
        results += robot.run(seconds)
    iq, iv = model.q_index[i], model.v_index[i]
    q, v, v_dot, tau = np.array([(r.state.q[iq], r.state.v[iv], r.v_dot[iv], r.solution.tau[i]) for r in results]).T
    rate = np.abs(np.diff(tau)).max() / robot.controller.period / effort
    left = effort * np.clip((NO_LOAD - np.abs(v)) / (NO_LOAD - CORNER), 0.0, 1.0)
    targets = [
        ("position beyond the stop", q.max() - stop, 1.0e-3, "rad"),
        ("speed beyond the fastest", np.abs(v).max() - fastest, 0.02, "rad/s"),
        ("acceleration beyond the largest", np.abs(v_dot).max() - ACCELERATION, 1.0e-4, "rad/s²"),
        ("torque beyond the limit", np.abs(tau).max() - effort, 1.0e-4, "N·m"),
        ("torque beyond what is left at the speed", (tau * np.sign(v) - left).max(), 1.0e-4, "N·m"),
        ("torque rate beyond the largest", rate - TORQUE_RATE, 1.0e-2, "1/s"),
        ("short of the stop", stop - q.max(), 5.0e-3, "rad"),
        ("short of the fastest", fastest - np.abs(v).max(), 0.2, "rad/s"),
        ("short of what is left at the speed", (left - tau * np.sign(v)).min(), 0.1, "N·m"),
    ]
    for what, value, most, unit in targets:
        print(f"{what}: {value:.4g} {unit} (at most {most:g})")
    print(f"bound: {', '.join(sorted({name for r in results for name in r.binding if JOINT in name}))}")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
