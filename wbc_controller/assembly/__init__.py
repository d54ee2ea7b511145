"""From settings to objects, and the checks before the robot moves."""
