"""The simulated world: environments, vehicle, sensors.  No other part of mavfi imports MuJoCo."""
