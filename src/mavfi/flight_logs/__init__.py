"""Readers of recorded flights, one module for each file format; what they hold trains detectors."""

from mavfi.flight_logs.reader import FlightLogReader, Layout, LoggedMessage, Number, open_flight_log

__all__ = ["FlightLogReader", "Layout", "LoggedMessage", "Number", "open_flight_log"]
