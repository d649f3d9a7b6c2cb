"""Compiled helpers independent of the application domain."""
