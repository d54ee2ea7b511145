"""The controller's reports."""
