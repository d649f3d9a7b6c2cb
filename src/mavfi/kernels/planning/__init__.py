"""Kernels from map to way-point."""
