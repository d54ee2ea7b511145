"""The robot: model from the URDF, actuation and dynamics."""
