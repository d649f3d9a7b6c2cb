"""Instrumented variants of compiled kernels, in which the result of one dynamic instruction can be changed."""
