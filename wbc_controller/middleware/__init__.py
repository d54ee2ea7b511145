"""ROS 2 interface independent of the transport."""
