"""Services of the nodes on any transport."""
