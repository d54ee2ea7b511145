"""Relative setpoints."""

import math

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.orientation import about_z, quaternion_of, rotation_of
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
    vector = np.concatenate([position[:n], np.zeros(max(0, 3 - n))])
    turn, target = (rotation_of(values[n:]) if form.oriented else np.eye(3) for values in (position, goal))
    if frame == heading:
        axes = _heading(dynamics)
        vector, turn = axes @ vector, axes @ turn @ axes.T
    elif frame != reference:
        pose = dynamics.placement(dynamics.model.frame_id(frame, "frame"))
        vector = pose.rotation @ vector + (0.0 if form.direction else pose.translation)
        turn = pose.rotation @ turn
    if frame in (reference, heading):
        turn = turn @ target
        if not form.direction:  # directions have no displacement
            vector[:n] += goal[:n]
    return np.concatenate([vector[:n], quaternion_of(turn)]) if form.oriented else vector[:n]


def _heading(dynamics: Dynamics) -> Array:
    """Return axes with z up and x along the base's heading, (3, 3)."""
    model = dynamics.model
    if not model.floating_base:
        return np.eye(3)
    x = rotation_of(dynamics.q[3:7])[:, 0]
    return about_z(math.atan2(x[1], x[0]))
