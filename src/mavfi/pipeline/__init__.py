"""The perception-planning-control pipeline: maps states to states, independent of faults and simulator."""
