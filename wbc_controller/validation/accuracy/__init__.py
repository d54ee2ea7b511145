"""How far a robot without odometry is from where it should be, and from where it is said to be: `wbc accuracy`."""
