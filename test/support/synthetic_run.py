"""A made-up run, for the tests and for a look at the report without a simulation."""

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.report.run_data import Phase, Result, RunData, supports_of
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings


def robot(name: str) -> tuple[Settings, RobotModel]:
    """Load a shipped robot."""
    settings = load_settings(find_configuration(name))
    return settings, make_model(settings)


def squat(name: str, duration: float = 24.0, rate: float = 500.0) -> tuple[RunData, RobotModel]:
    """Make up a run: stand, sway, squat, and a shove."""
    settings, model = robot(name)
    rng = np.random.default_rng(1)
    supports = supports_of(settings.contacts)
    data = model.pinocchio.createData()
    time = np.arange(0.0, duration, 1.0 / rate)
    phase = np.clip((time - 0.35 * duration) / (0.3 * duration), 0.0, 1.0)
    depth = 0.5 * (1.0 - np.cos(4.0 * np.pi * phase))
    sway = 0.04 * np.sin(2.0 * np.pi * 0.4 * time) * ((time > 0.12 * duration) & (time < 0.35 * duration))
    bends = {"hip_pitch": -0.5, "knee": 1.0, "ankle_pitch": -0.5, "thigh": 0.4, "calf": -0.8, "shoulder_pitch": -0.9,
             "elbow": 0.3, "leg_left_3": -0.45, "leg_left_4": 0.9, "leg_left_5": -0.45, "leg_right_3": -0.45,
             "leg_right_4": 0.9, "leg_right_5": -0.45}  # fmt: skip
    bend = np.array([next((v for k, v in bends.items() if k in joint), 0.0) for joint in model.joints])
    q = np.empty((len(time), model.nq))
    com = np.empty((len(time), 3))
    foot = next(iter(supports.values()))
    sole = model.pinocchio.getFrameId(foot.frame)
    for i in range(len(time)):
        q[i] = model.configuration(model.posture + depth[i] * bend)
        pin.framesForwardKinematics(model.pinocchio, data, q[i])
        ground = (data.oMf[sole] * pin.XYZQUATToSE3(np.array(foot.placement))).translation[2]
        ground -= getattr(next(iter(settings.contacts.values())), "radius", 0.0)
        q[i, 1:3] = sway[i], -ground
        com[i] = pin.centerOfMass(model.pinocchio, data, q[i])
    reference = com + np.array([0.0, 0.0, 0.0])
    com = com + 0.002 * np.cumsum(rng.normal(size=com.shape), axis=0) / np.sqrt(len(time))
    shoved = np.exp(-(((time - 0.8 * duration) / 0.35) ** 2))
    com[:, 1] += 0.03 * shoved
    weight = model.mass * model.gravity / len(supports)
    planned, true = {}, {}
    for i, contact in enumerate(supports):
        side = 1.0 if i % 2 == 0 else -1.0
        wrench = np.zeros((len(time), 6 if len(supports[contact].corners) > 1 else 3))
        wrench[:, 2] = weight * (1.0 + side * 8.0 * sway + 0.15 * np.gradient(depth, time) + side * 0.5 * shoved)
        wrench[:, 1] = 0.2 * weight * shoved + 60.0 * sway
        planned[contact] = wrench
        true[contact] = wrench + rng.normal(size=wrench.shape) * (0.012 * weight if wrench.shape[1] == 3 else 0.4)
        true[contact][:, 2] += rng.normal(size=len(time)) * 0.02 * weight
    tau = model.effort_limits * (
        0.08 * rng.uniform(0.3, 1.0, model.na) + np.outer(depth, np.abs(bend) * 0.5) + 0.3 * shoved[:, None]
    )
    tau *= 1.0 + 0.02 * rng.normal(size=tau.shape)
    cycles = 8.0e-4 * rng.lognormal(0.0, 0.18, size=len(time))
    names = [(0.0, "stand"), (0.12, "sway"), (0.35, "squat"), (0.65, "reach"), (0.77, "shove left"), (0.88, "settle")]
    run = RunData(
        robot=name,
        actuators=model.joints,
        time=time,
        q=q,
        tau=tau,
        effort_limits=model.effort_limits,
        com=com,
        com_reference=reference,
        task_errors={"pelvis": 0.01 * np.abs(np.sin(time)) + 0.05 * shoved, "left_hand": 0.02 * depth},
        contact_wrenches=planned,
        disturbance=np.zeros(len(time)),
        true_wrenches=true,
        friction={contact: settings.contacts[contact].friction for contact in supports},
        cycle_seconds=cycles,
        stage_seconds={"dynamics": 0.2 * cycles, "problem": 0.22 * cycles, "solver": 0.5 * cycles,
                       "safety": 0.03 * cycles, "transport": 0.05 * cycles},
        phases=tuple(Phase(share * duration, phase_name) for share, phase_name in names),
        results=(
            Result("Stands still", "com drift < 5 mm in 3 s", "1.2 mm", True),
            Result("Sways", "rms com error < 10 mm", "3.4 mm", True),
            Result("Squats 150 mm", "rms com error < 15 mm", "6.1 mm", True),
            Result("Reaches with both hands", "final error < 20 mm", "8.0 mm", True),
            Result("Takes a shove of 40 N·s", "stays up, capture < 1.5 s", "0.9 s", True),
            Result("Never slips", "friction use ≤ 1 <always>", "0.62", True),
            Result("Forces agree with the ground", "rms difference < 5 % of the weight", "2.2 %", True),
            Result("Keeps its torque limits", "100 %", "58 %", True),
            Result("Keeps time", "99 % of cycles < 2 ms", "1.21 ms", True),
        ),
        modes=((0.0, "inactive"), (0.2, "active")),
        supports=supports,
    )  # fmt: skip
    return run, model
