"""Our vehicle as a MAVLink autopilot with PX4's modes, over UDP on loopback (library pymavlink, extra `mavlink`)."""
