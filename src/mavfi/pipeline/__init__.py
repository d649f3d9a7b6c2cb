"""The perception-planning-control pipeline: states in, states out; it knows no faults and no simulator."""
