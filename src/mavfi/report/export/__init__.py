"""Export of flights to ROS 1 bag, ROS 2 mcap, PX4 ULog, MAVLink telemetry log and CSV files."""
