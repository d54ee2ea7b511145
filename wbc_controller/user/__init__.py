"""A user at the command line: sends requests to running nodes, and shows what they say."""
