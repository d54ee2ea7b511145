"""tsid's side of the comparison: runs in tsid's own environment, with nothing of wbc_controller, and speaks by pipe.

The first line on standard input is a JSON object, `Scene` of `tsid_process.py` as a dictionary; the answer is a line
with the numbers of unknowns, equalities and inequalities. Then every question is eight bytes with a count, and as many
rows of float64: q, v, and the centre of mass's reference (position, velocity, acceleration). The answer is as many
rows: v̇, τ, the wrench of each contact about its frame, and the seconds that one cycle of tsid took.
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
import time
from typing import Any, BinaryIO

import numpy as np
import pinocchio as pin
import tsid.tsid_pywrap as tsid


class TsidController:
    """Centre of mass, posture, orientation of a frame, surface contacts and torque limits, as tsid has them.

    tsid's Python binding does not keep what it is given: every object must stay referenced from here.
    """

    def __init__(self, scene: dict[str, Any]) -> None:
        full = pin.buildModelFromUrdf(scene["urdf"], pin.JointModelFreeFlyer())
        locked = [full.getJointId(name) for name in scene["locked"]]
        model = pin.buildReducedModel(full, locked, pin.neutral(full))
        if list(model.names) != scene["names"]:
            raise ValueError(f"the joints are {list(model.names)}, expected {scene['names']}")
        model.armature = np.array(scene["armature"])
        self.robot = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        self.formulation = tsid.InverseDynamicsFormulationAccForce("tsid", self.robot, False)
        q = np.array(scene["q"])
        self.formulation.computeProblemData(0.0, q, np.zeros(model.nv))
        data = self.formulation.data()
        self.contacts = []
        for contact in scene["contacts"]:
            x, y = contact["half_length"], contact["half_width"]
            corners = np.array([[-x, -x, x, x], [-y, y, -y, y], [0.0, 0.0, 0.0, 0.0]])
            made = tsid.Contact6d(
                contact["name"],
                self.robot,
                contact["frame"],
                corners,
                np.array([0.0, 0.0, 1.0]),
                # tsid holds |f_t| ≤ μ f_n along two axes, which is outside of the cone; we hold the pyramid within it.
                contact["friction"] / math.sqrt(2.0),
                contact["min_normal_force"],
                contact["max_normal_force"],
            )
            made.setKp(contact["stiffness"] * np.ones(6))
            made.setKd(contact["damping"] * np.ones(6))
            made.setReference(self.robot.framePosition(data, model.getFrameId(contact["frame"])))
            self.formulation.addRigidContact(made, scene["weights"]["force"])
            self.contacts.append(made)
        gains = {"Kp": scene["stiffness"], "Kd": scene["damping"]}
        self.com = tsid.TaskComEquality("com", self.robot)
        self.com_sample = tsid.TrajectorySample(3)
        _set_gains(self.com, 3, gains)
        self.formulation.addMotionTask(self.com, scene["weights"]["com"], 1, 0.0)
        self.posture = tsid.TaskJointPosture("posture", self.robot)
        _set_gains(self.posture, model.nv - 6, gains)
        self.posture_trajectory = tsid.TrajectoryEuclidianConstant("posture", q[7:])
        self.posture.setReference(self.posture_trajectory.computeNext())
        self.formulation.addMotionTask(self.posture, scene["weights"]["posture"], 1, 0.0)
        self.waist = tsid.TaskSE3Equality("waist", self.robot, scene["waist"])
        _set_gains(self.waist, 6, gains)
        self.waist.setMask(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
        placement = self.robot.framePosition(data, model.getFrameId(scene["waist"]))
        self.waist_trajectory = tsid.TrajectorySE3Constant("waist", placement)
        self.waist.setReference(self.waist_trajectory.computeNext())
        self.formulation.addMotionTask(self.waist, scene["weights"]["waist"], 1, 0.0)
        self.torques = tsid.TaskActuationBounds("torques", self.robot)
        effort = np.array(scene["effort_limits"])
        self.torques.setBounds(-effort, effort)
        self.formulation.addActuationTask(self.torques, 1.0, 0, 0.0)
        self.solver = tsid.SolverHQuadProgFast("solver")
        self.sizes = (self.formulation.nVar, self.formulation.nEq, self.formulation.nIn)
        self.solver.resize(*self.sizes)
        self.nq, self.nv = model.nq, model.nv

    def cycle(self, row: np.ndarray) -> np.ndarray:
        """Answer one row."""
        q, v, reference = np.split(row, [self.nq, self.nq + self.nv])
        self.com_sample.value(reference[:3])
        self.com_sample.derivative(reference[3:6])
        self.com_sample.second_derivative(reference[6:])
        self.com.setReference(self.com_sample)
        before = time.perf_counter()
        problem = self.formulation.computeProblemData(0.0, q, v)
        solution = self.solver.solve(problem)
        if solution.status != 0:
            return np.full(2 * self.nv - 6 + 6 * len(self.contacts) + 1, np.nan)
        tau = self.formulation.getActuatorForces(solution)
        seconds = time.perf_counter() - before
        v_dot = self.formulation.getAccelerations(solution)
        wrenches = [
            made.getForceGeneratorMatrix @ self.formulation.getContactForce(made.name, solution)
            for made in self.contacts
        ]
        return np.concatenate([v_dot, tau, *wrenches, [seconds]])


def _set_gains(task: Any, size: int, gains: dict[str, float]) -> None:
    task.setKp(gains["Kp"] * np.ones(size))
    task.setKd(gains["Kd"] * np.ones(size))


def serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answer until the pipe is closed."""
    controller = TsidController(json.loads(questions.readline()))
    answers.write((json.dumps(controller.sizes) + "\n").encode())
    answers.flush()
    width = controller.nq + controller.nv + 9
    while head := questions.read(8):
        (count,) = struct.unpack("<q", head)
        rows = np.frombuffer(questions.read(8 * count * width)).reshape(count, width)
        answers.write(b"".join(controller.cycle(row).tobytes() for row in rows))
        answers.flush()


if __name__ == "__main__":
    # What libraries print must not get between the answers.
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, pipe)
