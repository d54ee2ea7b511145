"""Mock robot: a MuJoCo plant with the topics of a real robot; only this package imports mujoco."""
