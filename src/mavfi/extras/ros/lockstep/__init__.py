"""The pipeline as ROS nodes in lock step: the same kernels, injector and detectors, one process each.

All of it is independent of the middleware; ROS 1 and ROS 2 implement `transport`.
"""
