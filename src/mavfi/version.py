"""The version, accessible from every layer."""

__version__ = "0.1.0"
