"""Flips bits in numbers of ROS 1 messages of any type, in serialized form."""
