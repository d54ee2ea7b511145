"""Controller and guard as services on any transport."""
