"""One flight in integer microseconds: scheduler, plant, taps and recovery, the building blocks of every host."""
