"""The pipeline as real ROS 1 nodes: the same kernels, injector and detectors, one process each.

The only package that imports ROS, and only inside of functions or of modules that run as nodes: everything else
works without it.
"""
