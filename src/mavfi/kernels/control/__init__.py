"""Kernels from way-point to command."""
