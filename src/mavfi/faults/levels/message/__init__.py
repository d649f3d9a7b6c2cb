"""Faults in messages: where a number stands in the bytes of one, and changes of whole publications."""
