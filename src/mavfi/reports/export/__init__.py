"""A flight as a file for other people's tools: ROS 1 bag, ROS 2 mcap, CSV."""
