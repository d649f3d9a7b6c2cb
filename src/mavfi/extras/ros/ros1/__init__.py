"""The pipeline as ROS 1 nodes: the same kernels, injector and detectors, one process each.

The only package that imports ROS, and only inside functions or in modules that run as nodes: all other code works
without it.
"""
