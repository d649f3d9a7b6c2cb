"""Detectors from established libraries (extra `bench`), applied to all fields, with limits set as for the others.

Libraries are imported when a detector is constructed.  A model stores its training rows and is refitted with a fixed
seed: this avoids the libraries' own file formats, which execute code on loading.
"""
