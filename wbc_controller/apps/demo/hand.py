"""Feasible motions of a hand along a straight line."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Steps of a motion, Newton iterations per step, and largest remaining error, m and rad.
_STEPS, _ITERATIONS, _MAX_ERROR = 10, 8, 1.0e-3
_MOTION_WEIGHT = 1.0e-3  # regularization weight of the joint motions
_MAX_EFFORT = 0.8  # of an effort limit, for gravity


class Hand:
    """A frame moved by an arm on a fixed base."""

    def __init__(self, model: RobotModel, frame: str, *, free_orientation: bool) -> None:
        """Compute the initial placement; `free_orientation` permits rotations."""
        self._model, self._frame, self._free_orientation = model, model.frame_id(frame, "frame"), free_orientation
        self._data = model.pinocchio.createData()
        carrying = set(model.pinocchio.supports[model.pinocchio.frames[self._frame].parentJoint])
        #: Indices in `model.joints` of the joints that move the hand.
        self._joint_indices = [
            i for i, name in enumerate(model.joints) if model.pinocchio.getJointId(name) in carrying
        ]  # fmt: skip
        start, J = self._kinematics(np.array(model.posture))
        self._start = pin.SE3(start)
        self.position = np.array(start.translation)  # (3,) in m
        free = np.eye(len(self._joint_indices)) if free_orientation else null_space(J[3:])
        ways = J[:3] @ free
        #: Unit vector of the largest hand motion per joint motion, (3,).
        self.easiest_direction = np.linalg.eigh(ways @ ways.T)[1][:, 2]

    def _kinematics(self, posture: Array) -> tuple[pin.SE3, Array]:
        """Return placement and Jacobian of the own joints, (6, k), in a posture, (nj,)."""
        model = self._model
        q = model.configuration(posture)
        pin.computeJointJacobians(model.pinocchio, self._data, q)
        pin.updateFramePlacements(model.pinocchio, self._data)
        J = np.array(pin.getFrameJacobian(model.pinocchio, self._data, self._frame, pin.LOCAL_WORLD_ALIGNED))
        J = J.reshape(6, model.nv)
        if model.followers is not None:
            for row in J:
                model.followers.carry(row)
        return self._data.oMf[self._frame], J[:, model.v_index[self._joint_indices]]

    def feasible_part(self, motion: Array, margin: float) -> Array:
        """Return the feasible part of a straight `motion`, (3,) in m, with joints `margin` rad off the limits."""
        model, posture = self._model, np.array(self._model.posture)
        effort, reached = max(_MAX_EFFORT, self._effort(np.array(model.posture))), 0.0
        for step in range(1, _STEPS + 1):
            goal = self.position + step / _STEPS * motion
            for _ in range(_ITERATIONS):
                place, J = self._kinematics(posture)
                turned = pin.log3(self._start.rotation @ place.rotation.T)
                error = np.concatenate([goal - place.translation, np.zeros(3) if self._free_orientation else turned])
                J = J[:3] if self._free_orientation else J
                rows = np.vstack([J, _MOTION_WEIGHT * np.eye(len(self._joint_indices))])
                right_side = np.concatenate([error[: len(J)], np.zeros(len(self._joint_indices))])
                posture[self._joint_indices] += np.linalg.lstsq(rows, right_side, rcond=None)[0]
            within = not model.joint_beyond_limits(posture, margin)
            if not (within and np.abs(error).max() <= _MAX_ERROR and self._effort(posture) <= effort):
                break
            reached = step / _STEPS
        return reached * motion

    def _effort(self, posture: Array) -> float:
        """Return the largest share of an effort limit that gravity takes."""
        model = self._model
        gravity = pin.computeGeneralizedGravity(model.pinocchio, self._data, model.configuration(posture))
        return float(np.max(np.abs(model.actuation.torques(gravity)) / model.effort_limits))
