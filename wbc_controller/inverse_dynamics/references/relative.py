"""Setpoints that are given from the task's own reference, by the robot's heading, or in a frame of the robot."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.records import Array


def own_frames(task: str) -> tuple[str, str]:
    """The two frames at a task's reference: with the axes of its references, and with x along the robot's heading."""
    return f"{task}/reference", f"{task}/heading"


def in_world(task: str, frame: str, position: Array, goal: Array, form: ReferenceForm, dynamics: Dynamics) -> Array:
    """Transform a setpoint that was given in another frame to the frame of the task's references, mostly the world.

    Args:
        frame: one of `own_frames`, or a frame of the robot at its present place.
        position: in the form of the task's references: in m for positions, and a unit quaternion for orientations.
        goal: the reference that the task moves to, in the same form. A vector is added to it; an orientation turns it,
            about axes through its origin.
    """
    n = form.vector
    reference, heading = own_frames(task)
    if frame not in (reference, heading):
        pose = dynamics.placement(dynamics.model.frame_id(frame, "frame"))
        vector = pose.rotation @ _three(position, n) + (0.0 if form.direction else pose.translation)
        return _joined(vector[:n], pose.rotation @ _rotation(position[n:]), form)
    axes = _heading(dynamics) if frame == heading else np.eye(3)
    offset = (axes @ _three(position, n))[:n] if frame == heading else position[:n]
    if form.direction:  # from one direction to another there is no displacement that could be added
        return offset
    if not form.oriented:
        return np.asarray(goal[:n] + offset)
    return _joined(goal[:n] + offset, axes @ _rotation(position[n:]) @ axes.T @ _rotation(goal[n:]), form)


def _three(position: Array, n: int) -> Array:
    """The vector of a position in three coordinates; those that the form lacks are 0."""
    return np.concatenate([position[:n], np.zeros(3 - n)])


def _joined(vector: Array, rotation: Array, form: ReferenceForm) -> Array:
    return np.concatenate([vector, quaternion_of(rotation)]) if form.oriented else vector


def _rotation(quaternion: Array) -> Array:
    """Rotation matrix of a quaternion, (3, 3); none where the form has no orientation."""
    if not len(quaternion):
        return np.eye(3)
    return rotation_of(quaternion)


def _heading(dynamics: Dynamics) -> Array:
    """Axes with z up, and x where the base's x-axis points on the level, (3, 3); the world's for a fixed base."""
    model = dynamics.model
    if not model.floating_base:
        return np.eye(3)
    x = _rotation(dynamics.q[3:7])[:, 0]
    yaw = math.atan2(x[1], x[0])
    return np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
