"""What is on the wire and what it means: the table of topics, the codec, one message to its meaning."""
