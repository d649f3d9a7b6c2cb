"""Compiled helpers without domain words."""
