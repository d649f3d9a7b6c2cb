"""`mavfi demo`: ten telling faults, flown, told in a sentence each, and drawn."""
