"""A made-up run, for the tests of the report without a simulation."""

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.report.run_data import Result, RunData
from wbc_controller.settings.config import load


def squat(name: str, duration: float, rate: float) -> tuple[RunData, RobotModel]:
    """Make up a run of a robot on flat soles: stand, squat, and a shove."""
    settings = load(name).settings
    model = make_model(settings)
    rng = np.random.default_rng(1)
    data = model.pinocchio.createData()
    time = np.arange(0.0, duration, 1.0 / rate)
    n = len(time)
    depth = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.clip(time / (0.6 * duration), 0.0, 1.0)))
    shoved = np.exp(-(((time - 0.8 * duration) / 0.35) ** 2))
    bends = {"hip_pitch": -0.5, "knee": 1.0, "ankle_pitch": -0.5}
    bend = np.array([next((v for k, v in bends.items() if k in joint), 0.0) for joint in model.joints])
    q = np.array([model.configuration(model.posture + each * bend) for each in depth])
    joint, foot = contact_placement(model, *next(iter(settings.contacts.items())))
    for row in q:
        pin.forwardKinematics(model.pinocchio, data, row)
        row[2] -= (data.oMi[joint] * foot).translation[2]
    com = np.array([pin.centerOfMass(model.pinocchio, data, row) for row in q])
    weight = model.mass * model.gravity / len(settings.contacts)
    planned, true = {}, {}
    for contact in settings.contacts:
        wrench = np.zeros((n, 6))
        wrench[:, 2] = weight * (1.0 + 0.5 * shoved)
        wrench[:, 1] = 0.2 * weight * shoved
        planned[contact] = wrench
        true[contact] = wrench + rng.normal(size=wrench.shape)
    cycles = 8.0e-4 * rng.lognormal(0.0, 0.18, size=n)
    run = RunData(
        robot=name,
        actuators=model.actuators,
        time=time,
        q=q,
        tau=model.effort_limits * (0.1 + 0.3 * shoved[:, None] + 0.02 * rng.normal(size=(n, model.na))),
        effort_limits=model.effort_limits,
        com=com + 0.03 * shoved[:, None],
        com_reference=com,
        disturbance=np.zeros(n),
        task_errors={"pelvis": 0.05 * shoved, "left_hand": 0.02 * depth},
        contact_wrenches=planned,
        true_wrenches=true,
        friction={name: contact.friction for name, contact in settings.contacts.items()},
        cycle_seconds=cycles,
        stage_seconds={"compute": 0.7 * cycles, "write": 0.05 * cycles},
        phases=((0.0, "stand"), (0.1 * duration, "squat"), (0.7 * duration, "shove left")),
        results=(Result("Stands still", "below 5 mm", "1.2 mm", True), Result("Slips", "never <in it>", "0.62", True)),
        modes=((0.0, "inactive"), (0.2, "active")),
        contacts=settings.contacts,
    )
    return run, model
