"""Report of a run as a page."""
