"""The version, accessible from every layer."""

__version__ = "1.0.0"
