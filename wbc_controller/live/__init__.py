"""The nodes as processes of their own, for live trials and measurements."""
