"""Nodes on rclpy, their parameters and process."""
