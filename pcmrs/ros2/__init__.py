"""ROS 2 without ROS: CDR messages on keys that zenoh-bridge-ros2dds maps to topics, and poses from there."""
