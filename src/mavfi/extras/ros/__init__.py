"""ROS: faults and detectors in running graphs, the pipeline as nodes, campaigns on foreign nodes."""
