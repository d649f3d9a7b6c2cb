"""Export of flights to ROS 1 bag, ROS 2 mcap and CSV files."""
