"""ROS 2: faults and detectors in running graphs, campaigns on foreign stacks, the pipeline as nodes.

Nothing here imports ROS into mavfi's own process, except the nodes of a flight: programs run with the Python of a ROS
installation (see `environment`).
"""
