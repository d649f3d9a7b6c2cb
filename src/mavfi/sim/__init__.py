"""The simulated world: environments, vehicle, sensors.  Nothing else of mavfi imports MuJoCo."""
