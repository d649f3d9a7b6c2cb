"""Flips bits in numbers of ROS 1 messages of any type, as they are on the wire."""
