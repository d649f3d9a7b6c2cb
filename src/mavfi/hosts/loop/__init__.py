"""One flight on integer microseconds: scheduler, plant, taps, recovery; every host composes its flights from these."""
