"""Worker of tsid, in its own environment; `serving.py` contains the protocol."""

import math
import time
from importlib.metadata import version
from typing import Any

import numpy as np
import pinocchio as pin
import tsid.tsid_pywrap as tsid
from serving import describe, serve

_UP = np.array([0.0, 0.0, 1.0])


class TsidController:
    """Centre of mass, posture, orientation of a frame, contacts and torque limits, in tsid.

    tsid's Python binding does not store references, so all objects are stored here.
    """

    def __init__(self, scene: dict[str, Any]) -> None:
        model = pin.buildModelFromXML(scene["urdf"], pin.JointModelFreeFlyer())
        if list(model.names)[2:] != scene["joints"]:
            raise ValueError(f"joints {list(model.names)[2:]}, expected {scene['joints']}")
        model.armature = np.array(scene["armature"])
        self.robot = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        self.formulation = tsid.InverseDynamicsFormulationAccForce("tsid", self.robot, False)
        q = np.array(scene["q"])
        self.formulation.computeProblemData(0.0, q, np.zeros(model.nv))
        data = self.formulation.data()
        self.contacts = []
        for contact in scene["contacts"]:
            made, size = self._contact(contact)
            _set_gains(made, contact, size)
            made.setReference(self.robot.framePosition(data, model.getFrameId(contact["frame"])))
            self.formulation.addRigidContact(made, scene["weights"]["force"])
            self.contacts.append(made)
        self.com = tsid.TaskComEquality("com", self.robot)
        self.com_sample = tsid.TrajectorySample(3)
        _set_gains(self.com, scene, 3)
        self.formulation.addMotionTask(self.com, scene["weights"]["com"], 1, 0.0)
        self.posture = tsid.TaskJointPosture("posture", self.robot)
        _set_gains(self.posture, scene, model.nv - 6)
        self.posture_trajectory = tsid.TrajectoryEuclidianConstant("posture", q[7:])
        self.posture.setReference(self.posture_trajectory.computeNext())
        self.formulation.addMotionTask(self.posture, scene["weights"]["posture"], 1, 0.0)
        self.waist = tsid.TaskSE3Equality("waist", self.robot, scene["waist"])
        _set_gains(self.waist, scene, 6)
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
        counts = (self.formulation.nVar, self.formulation.nEq, self.formulation.nIn)
        self.solver.resize(*counts)
        forces = sum(3 if contact["type"] == "point" else 6 for contact in scene["contacts"])
        self.hello = describe(version("tsid"), counts, (model.nv, model.nv - 6, forces), ("build", "solve", "unpack"))

    def _contact(self, contact: dict[str, Any]) -> tuple[Any, int]:
        # tsid limits |f_t| ≤ μ f_n along two axes, outside of the cone; ours uses the inner pyramid.
        bounds = (contact["friction"] / math.sqrt(2.0), contact["min_normal_force"], contact["max_normal_force"])
        if contact["type"] == "point":
            made = tsid.ContactPoint(contact["name"], self.robot, contact["frame"], _UP, *bounds)
            made.useLocalFrame(False)
            return made, 3
        x, y = contact["half_length"], contact["half_width"]
        corners = np.array([[-x, -x, x, x], [-y, y, -y, y], [0.0, 0.0, 0.0, 0.0]])
        return tsid.Contact6d(contact["name"], self.robot, contact["frame"], corners, _UP, *bounds), 6

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state."""
        self.com_sample.value(reference[:3])
        self.com_sample.derivative(reference[3:6])
        self.com_sample.second_derivative(reference[6:])
        self.com.setReference(self.com_sample)
        started = time.perf_counter()
        problem = self.formulation.computeProblemData(0.0, q, v)
        built = time.perf_counter()
        solution = self.solver.solve(problem)
        solved = time.perf_counter()
        if solution.status != 0:
            return np.full(sum(self.hello["sizes"]) + 4, np.nan)
        tau = self.formulation.getActuatorForces(solution)
        ended = time.perf_counter()
        v_dot = self.formulation.getAccelerations(solution)
        forces = [
            made.getForceGeneratorMatrix @ self.formulation.getContactForce(made.name, solution)
            for made in self.contacts
        ]
        return np.concatenate([v_dot, tau, *forces, [built - started, solved - built, ended - solved, ended - started]])


def _set_gains(task: Any, gains: dict[str, Any], size: int) -> None:
    task.setKp(gains["stiffness"] * np.ones(size))
    task.setKd(gains["damping"] * np.ones(size))


if __name__ == "__main__":
    serve(TsidController)
