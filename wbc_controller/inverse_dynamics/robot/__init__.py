"""The robot: model from the URDF, actuation of the joints, and dynamics."""
