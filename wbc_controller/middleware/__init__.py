"""The ROS 2 interface independent of the transport: table of topics, message codec, and decoders."""
