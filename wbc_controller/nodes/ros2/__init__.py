"""The ROS 2 side: nodes on rclpy, their parameters and their process. Importing a node requires ROS 2."""
