"""The limits of torques, joint motion and distances: one file per kind."""

from wbc_controller.core.limits.joint_motion import JointMotionLimit
from wbc_controller.core.limits.limit import RowLimit
from wbc_controller.core.limits.self_collision import SelfCollisionLimit
from wbc_controller.core.limits.torque import TorqueLimit, TorqueSpeedCurve

__all__ = ["JointMotionLimit", "RowLimit", "SelfCollisionLimit", "TorqueLimit", "TorqueSpeedCurve"]
