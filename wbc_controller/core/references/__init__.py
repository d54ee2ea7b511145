"""What is wanted of the robot: changes by command, trajectories and ramps, and their values at any time."""
