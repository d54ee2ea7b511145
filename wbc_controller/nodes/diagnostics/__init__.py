"""The controller's reports: diagnostics, markers, and the values and references of the tasks."""
