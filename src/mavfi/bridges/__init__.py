"""Bridges to other people's software: one folder each, every one an optional extra; nothing else depends on them."""
