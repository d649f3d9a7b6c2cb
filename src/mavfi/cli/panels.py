"""Panels of help: of the options of one command, and of the list of all commands."""

MISSION = "Mission"
PIPELINE = "Vehicle and pipeline"
FAULT = "Fault"
DETECTION = "Detector and recovery"
OUTPUT = "Output"
OF_OPTIONS = (MISSION, PIPELINE, FAULT, DETECTION, OUTPUT)
"""Panels of commands that fly a mission, in their order."""

OTHERS = "More commands"
OF_COMMANDS = ("Fly and look", "Campaigns", "Detectors", "Other programs", "Tools", OTHERS)
"""Panels of `mavfi --help`, in their order.

A module names that of its commands in `HELP_PANEL`, as text: help is read from the source, and imports no module.
"""
