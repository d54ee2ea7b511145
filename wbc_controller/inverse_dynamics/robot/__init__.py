"""The robot: its model from the URDF, the actuation of its joints, and its dynamics at one state."""
