"""Arithmetic of the perception, planning and control kernels: compiled, one algorithm per file."""
