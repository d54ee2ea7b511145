"""States and torques in other conventions."""
