"""The demo: a run of the controller on the mock robot, a recording of it, and an HTML report."""
