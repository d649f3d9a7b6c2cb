"""Faults in messages inside ROS 2 processes: a C library, the page by which it is controlled, loading it.

`interposer.c` is placed at the boundary from rcl to rmw, preloaded or loaded into a running process; `page` arms faults
and reads reports; `attach` loads the library into running processes.
"""
