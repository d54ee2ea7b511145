"""Errors of posture and estimate without odometry: `wbc accuracy`."""
