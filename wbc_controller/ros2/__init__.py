"""The ROS 2 side: nodes on rclpy, their parameters, their process. Whoever imports a node here needs ROS 2."""
