"""Errors of the posture and the estimate of robots without odometry: `wbc accuracy`."""
