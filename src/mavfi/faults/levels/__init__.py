"""Fault levels: what can go wrong, one module or folder for each."""
