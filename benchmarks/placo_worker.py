"""Worker of placo, in its own environment; `serving.py` contains the protocol."""

import math
import time
from importlib.metadata import version
from typing import Any

import numpy as np
import placo
from serving import describe, serve


class PlacoController:
    """Centre of mass, posture, orientation of a frame, contacts and torque limits, in placo's DynamicsSolver."""

    def __init__(self, scene: dict[str, Any]) -> None:
        self.robot = placo.RobotWrapper("", placo.Flags.ignore_collisions, scene["urdf"])
        model = self.robot.model
        if list(model.names)[2:] != scene["joints"]:
            raise ValueError(f"joints {list(model.names)[2:]}, expected {scene['joints']}")
        model.armature = np.array(scene["armature"])
        self._place(np.array(scene["q"]), np.zeros(model.nv))
        solver = self.solver = placo.DynamicsSolver(self.robot)
        solver.torque_cost = 0.0  # the forces are regularized, as in ours
        weights = scene["weights"]
        self.contacts = [self._contact(contact, weights["force"]) for contact in scene["contacts"]]
        self.com = solver.add_com_task(self.robot.com_world())
        posture = solver.add_joints_task()
        posture.set_joints({name: self.robot.get_joint(name) for name in self.robot.joint_names()})
        waist = solver.add_orientation_task(scene["waist"], self.robot.get_T_world_frame(scene["waist"])[:3, :3])
        for name, task in (("com", self.com), ("posture", posture), ("waist", waist)):
            task.configure(name, "soft", weights[name])
            task.kp, task.kd = scene["stiffness"], scene["damping"]
        for name, limit in zip(scene["joints"], scene["effort_limits"], strict=True):
            solver.set_torque_limit(name, limit)
        solver.enable_torque_limits(True)
        solver.enable_joint_limits(False)
        solver.enable_velocity_limits(False)
        solver.solve()
        problem = solver.problem
        forces = sum(3 if contact["type"] == "point" else 6 for contact in scene["contacts"])
        counts = problem.n_variables, problem.n_equalities, problem.n_inequalities
        self.hello = describe(version("placo"), counts, (model.nv, model.nv - 6, forces), ("kinematics", "solve"))

    def _contact(self, contact: dict[str, Any], weight: float) -> Any:
        placement = self.robot.get_T_world_frame(contact["frame"])
        if contact["type"] == "point":
            task = self.solver.add_position_task(contact["frame"], placement[:3, 3])
            objectives = [task]
            made = self.solver.add_unilateral_point_contact(task)
        else:
            task = self.solver.add_frame_task(contact["frame"], placement)
            objectives = [task.position(), task.orientation()]
            made = self.solver.add_planar_contact(task)
            made.length, made.width = 2.0 * contact["half_length"], 2.0 * contact["half_width"]
            made.weight_moments = weight
        task.configure(contact["name"], "hard")
        for each in objectives:
            each.kp, each.kd = contact["stiffness"], contact["damping"]
        # placo limits |f_t| ≤ μ f_n along two axes, outside of the cone; ours uses the inner pyramid.
        made.mu = contact["friction"] / math.sqrt(2.0)
        made.weight_forces, made.weight_tangentials = weight, 0.0
        return made

    def _place(self, q: np.ndarray, v: np.ndarray) -> None:
        self.robot.state.q, self.robot.state.qd = q, v
        self.robot.update_kinematics()

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state."""
        self.com.target_world, self.com.dtarget_world, self.com.ddtarget_world = np.split(reference, 3)
        started = time.perf_counter()
        self._place(q, v)
        placed = time.perf_counter()
        result = self.solver.solve()
        ended = time.perf_counter()
        if not result.success:
            return np.full(sum(self.hello["sizes"]) + 3, np.nan)
        forces = [made.wrench.ravel() for made in self.contacts]
        times = [placed - started, ended - placed, ended - started]
        return np.concatenate([result.qdd, result.tau[6:], *forces, times])


if __name__ == "__main__":
    serve(PlacoController)
