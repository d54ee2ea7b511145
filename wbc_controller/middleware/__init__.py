"""The ROS 2 interface, free of any transport: the table of topics, the message codec, and the decoding of messages."""
