"""Relative setpoints."""

import math

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.records import Array


def own_frames(task: str) -> tuple[str, str]:
    """Return the two frames at a task's reference: with its axes, and with x along the heading."""
    return f"{task}/reference", f"{task}/heading"


def in_world(task: str, frame: str, position: Array, goal: Array, form: ReferenceForm, dynamics: Dynamics) -> Array:
    """Transform a setpoint to the frame of the task's references.

    In `own_frames`, the setpoint is relative to the target `goal`; else `frame` is a robot frame.
    """
    n = form.vector
    reference, heading = own_frames(task)
    if frame not in (reference, heading):
        pose = dynamics.placement(dynamics.model.frame_id(frame, "frame"))
        vector = pose.rotation @ _padded_vector(position, n) + (0.0 if form.direction else pose.translation)
        return _assembled(vector[:n], pose.rotation @ _rotation(position[n:]), form)
    axes = _heading(dynamics) if frame == heading else np.eye(3)
    offset = (axes @ _padded_vector(position, n))[:n] if frame == heading else position[:n]
    if form.direction:  # directions have no displacement
        return offset
    if not form.oriented:
        return np.asarray(goal[:n] + offset)
    return _assembled(goal[:n] + offset, axes @ _rotation(position[n:]) @ axes.T @ _rotation(goal[n:]), form)


def _padded_vector(position: Array, n: int) -> Array:
    return np.concatenate([position[:n], np.zeros(3 - n)])


def _assembled(vector: Array, rotation: Array, form: ReferenceForm) -> Array:
    return np.concatenate([vector, quaternion_of(rotation)]) if form.oriented else vector


def _rotation(quaternion: Array) -> Array:
    return rotation_of(quaternion) if len(quaternion) else np.eye(3)


def _heading(dynamics: Dynamics) -> Array:
    """Return axes with z up and x along the base's heading, (3, 3)."""
    model = dynamics.model
    if not model.floating_base:
        return np.eye(3)
    x = _rotation(dynamics.q[3:7])[:, 0]
    yaw = math.atan2(x[1], x[0])
    return np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
