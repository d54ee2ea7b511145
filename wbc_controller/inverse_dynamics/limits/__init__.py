"""Limits: one file per kind."""

from wbc_controller.inverse_dynamics.limits.joint_motion import JointMotionLimit
from wbc_controller.inverse_dynamics.limits.limit import RowLimit
from wbc_controller.inverse_dynamics.limits.self_collision import SelfCollisionLimit
from wbc_controller.inverse_dynamics.limits.torque import TorqueLimit, TorqueSpeedCurve

__all__ = ["JointMotionLimit", "RowLimit", "SelfCollisionLimit", "TorqueLimit", "TorqueSpeedCurve"]
