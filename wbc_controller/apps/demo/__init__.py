"""Demonstration of the controller on the mock robot, with a recording and an HTML report."""
