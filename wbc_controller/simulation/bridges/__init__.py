"""States and torques by joint name, and in MuJoCo's conventions."""
