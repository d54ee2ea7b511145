"""Controller of one robot."""
