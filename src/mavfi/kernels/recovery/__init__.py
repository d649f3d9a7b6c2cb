"""Kernels from alarm to response."""
