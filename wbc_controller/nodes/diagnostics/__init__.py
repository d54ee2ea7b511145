"""The controller's reports: diagnostics, markers, and task values and references."""
