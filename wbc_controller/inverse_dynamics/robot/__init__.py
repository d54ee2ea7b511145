"""Robot: model, actuation and dynamics."""
