"""ROS 2 without ROS: what a cell says as CDR on keys that zenoh-bridge-ros2dds maps to topics, and poses from there."""
