"""The demo: a run of the controller on the mock robot, what it observed, and the page that shows it."""
