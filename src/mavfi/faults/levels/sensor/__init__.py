"""Failures of sensors and motors with PX4's names: the planned fault, the failing signal, and the failing vehicle."""
