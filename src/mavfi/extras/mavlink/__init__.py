"""MAVLink: a link with faults between a program and the autopilot that it flies; frames, also those of logs."""
