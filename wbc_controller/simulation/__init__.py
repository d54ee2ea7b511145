"""A mock robot: a MuJoCo plant behind the topics of a real one. The only part that imports mujoco."""
