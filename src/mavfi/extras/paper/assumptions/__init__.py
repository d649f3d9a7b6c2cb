"""Which assumptions produce the paper's tables: a designed set of readings, fitted, frozen and judged."""
