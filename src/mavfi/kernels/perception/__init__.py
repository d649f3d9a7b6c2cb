"""Kernels from depth image to collision check."""
