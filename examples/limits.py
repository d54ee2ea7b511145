"""An elbow of G1 accelerates to a goal beyond its stop, in MuJoCo; all limits hold.

Limits of position, velocity, acceleration, torque, torque rate, and the torque-speed curve.
"""

import sys

import numpy as np

import wbc_controller as wbc

JOINT = "left_elbow_joint"
CORNER, NO_LOAD = 0.5, 3.6  # rad/s
FASTEST, ACCELERATION, TORQUE_RATE = 0.1, 60.0, 40.0  # share of the velocity limit, rad/s², effort limits per second


def configuration() -> wbc.Config:
    """Return G1 with a fast elbow task and tight limits."""
    return wbc.load("g1").replace({
        "tasks.fling": {"type": "posture", "joints": [JOINT], "stiffness": 400.0, "setpoint_duration": 0.0},
        "limits": {"velocity_scale": FASTEST, "acceleration": ACCELERATION, "torque_rate": TORQUE_RATE},
        "limits.torque_speed": {"enabled": True, "actuators": {JOINT: {"corner": CORNER, "no_load": NO_LOAD}}},
    })  # fmt: skip


def main() -> int:
    """Move the elbow between goals; return 0 if every limit was reached and held."""
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
        ("position above limit", q.max() - stop, 1.0e-3, "rad"),
        ("velocity above limit", np.abs(v).max() - fastest, 0.02, "rad/s"),
        ("acceleration above limit", np.abs(v_dot).max() - ACCELERATION, 1.0e-4, "rad/s²"),
        ("torque above limit", np.abs(tau).max() - effort, 1.0e-4, "N·m"),
        ("torque above torque-speed curve", (tau * np.sign(v) - left).max(), 1.0e-4, "N·m"),
        ("torque rate above limit", rate - TORQUE_RATE, 1.0e-2, "1/s"),
        ("position below limit", stop - q.max(), 5.0e-3, "rad"),
        ("velocity below limit", fastest - np.abs(v).max(), 0.2, "rad/s"),
        ("torque below torque-speed curve", (left - tau * np.sign(v)).min(), 0.1, "N·m"),
    ]
    for name, value, most, unit in targets:
        print(f"{name}: {value:.4g} {unit} (at most {most:g})")
    print(f"binding: {', '.join(sorted({name for r in results for name in r.binding if JOINT in name}))}")
    return int(not all(value <= most for _, value, most, _ in targets))


if __name__ == "__main__":
    sys.exit(main())
