"""The report of a run as a page: `wbc report`, and the report of the demo."""
