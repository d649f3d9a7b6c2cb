"""Faults: types, draws and injectors for each level."""
