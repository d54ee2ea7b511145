"""G1 sways from foot to foot in the simulator while contacts and tasks are switched: 60 switches, and no jump."""

import numpy as np
import yaml

from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

SWITCHES = 60
#: Lateral amplitude, m; times of motion, on each side, and between task switches, s.
SWAY, WAY, STAY, PAUSE = 0.1, 2.0, 0.6, 0.06
#: Largest torque step, as a share of the torque rate limit.
SMOOTH = 0.2
#: Largest motion of a stance foot, m.
STANDS = 2.0e-3
_SOLE = {"type": "frame_pose", "weight": 100.0, "enabled": False}
#: Changes of G1: a task for each unloaded sole.
CHANGES = {
    "tasks.com.setpoint_duration": WAY,
    **{f"tasks.{side}_sole": _SOLE | {"frame": f"{side}_ankle_roll_link"} for side in ("left", "right")},
}


def random_task_switch(rng, enabled, weights):
    """Return a change of one or two tasks, and its number of switches."""
    kind = rng.integers(3)
    if kind == 0:
        task = str(rng.choice(["left_hand", "right_hand", "torso", "pelvis", "com"]))
        return {task: {"weight": float(weights[task] * 10.0 ** rng.uniform(-1.0, 1.0))}}, 1
    tasks = [str(rng.choice(["left_hand", "right_hand", "torso"]))] if kind == 1 else ["left_hand", "right_hand"]
    for task in tasks:
        enabled[task] = not enabled[task]
    return {task: {"enabled": enabled[task]} for task in tasks}, len(tasks)


def test_the_robot_stands_and_no_torque_jumps_and_no_foot_pulls_or_slips():
    robot, reports, switches, moved = EstimationTrial("g1", CHANGES), [], 0, 0.0
    settings, qp = robot.settings, robot.controller.qp

    def soles():
        return {name: each.points(qp.dynamics).mean(axis=0) for name, each in qp.contacts.items()}

    robot.stand()
    robot.loop.observers += (reports.append,)
    rng, start, stood = np.random.default_rng(0), np.array(qp.dynamics.com), soles()
    enabled = {name: task.enabled for name, task in settings.tasks.items()}
    weights = {name: task.weight for name, task in settings.tasks.items()}
    begun = time = robot.time
    side, arrives, due, light, back = -1, time, time, None, 0.0
    while switches < SWITCHES or light:
        changes: dict[str, dict] = {"tasks": {}, "contacts": {}}
        time = robot.time
        if time >= arrives + STAY or begun == time:
            side, arrives = -side, time + WAY
            changes["tasks"]["com"] = {"setpoint": [float(start[0]), float(start[1] + side * SWAY), float(start[2])]}
        foot = "right" if side > 0 else "left"
        if light is None and arrives <= time < arrives + 0.01:
            # The unloaded foot lifts for a random time; its task starts in the same cycle.
            light, back = foot, time + rng.uniform(0.2, STAY - 0.05)
            changes["contacts"][f"{foot}_foot"] = {"enabled": False}
            changes["tasks"] |= {f"{foot}_sole": {"enabled": True}}
            switches += 2
        elif light is not None and time >= back:
            changes["contacts"][f"{light}_foot"] = {"enabled": True}
            changes["tasks"] |= {f"{light}_sole": {"enabled": False}}
            light = None
            switches += 2
        if time >= due:
            due = time + PAUSE
            change, count = random_task_switch(rng, enabled, weights)
            for task, fields in change.items():
                changes["tasks"][task] = changes["tasks"].get(task, {}) | fields
            switches += count
        changes = {section: entries for section, entries in changes.items() if entries}
        if changes:
            robot.user.send_text("update", yaml.safe_dump(changes))
        robot.run(1.0 / settings.control.rate)
        for name, place in soles().items():
            if light is None or name != f"{light}_foot":
                moved = max(moved, float(np.linalg.norm(place - stood[name])))
    robot.run(0.6)  # an error unless it stands and is active
    assert switches >= SWITCHES
    assert not [sentence for report in reports for sentence in report.refused]
    assert not any(report.solution.relaxed for report in reports)
    assert {len(report.solution.forces) for report in reports} == {1, 2}  # a foot did leave
    assert moved < STANDS

    model, steps = robot.loop.controller.model, np.abs(np.diff([report.command.tau for report in reports], axis=0))
    share = steps / (settings.limits.torque_rate * model.effort_limits / settings.control.rate)
    print(f"largest torque step: {share.max():.2f} of the rate, {steps.max():.2f} N·m per cycle")
    assert share.max() < SMOOTH

    least, most = np.inf, 0.0
    for report in reports:
        for name, force in report.solution.forces.items():
            least = min(least, force[2])
            most = max(most, np.hypot(force[0], force[1]) - settings.contacts[name].friction * force[2])
    print(f"least normal force {least:.2e} N, largest friction beyond its cone {most:.2e} N")
    assert least > -1e-6 * model.mass * 9.81
    assert most < 1e-6 * model.mass * 9.81
