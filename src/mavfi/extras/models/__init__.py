"""Vehicles and worlds of other simulators: SDF, URDF, xacro, PX4's airframes, MJCF scenes, Aerialist's test cases."""
