"""The errors of robots without odometry, of their posture and of their estimate: `wbc accuracy`."""
