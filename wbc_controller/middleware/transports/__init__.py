"""The ends that carry messages: in memory, by DDS, by ROS 2. All are wired from `wbc_controller.middleware.topics`."""
