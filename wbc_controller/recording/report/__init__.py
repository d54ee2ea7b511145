"""Report of a run as a page, for `wbc report` and the demo."""
