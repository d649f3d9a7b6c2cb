"""Fault levels: what can go wrong, with all that a level needs (see `level.Level`) in one module each."""
