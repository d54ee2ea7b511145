"""The robot: its model from the URDF, what drives its joints, and its dynamics at one state."""
