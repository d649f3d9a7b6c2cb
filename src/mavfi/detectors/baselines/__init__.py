"""Detectors of well-kept libraries (extra `bench`), over all fields and with the rule of limits of the others.

The libraries are imported when a detector is made.  Its model holds the rows that it was fitted to, so that no file of
a library's own, which runs code when it is read, is needed: it is fitted again, with a fixed seed.
"""
