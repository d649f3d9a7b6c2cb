"""The pipeline as ROS nodes in lock step: the same kernels, injector and detectors, one process each.

`transport` is what a flight needs of ROS 2.
"""
