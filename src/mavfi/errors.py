"""Errors that a user of mavfi can meet.  The command line turns each into one line and an exit code."""


class MavfiError(Exception):
    """Base of every error that mavfi raises on purpose."""


class BadInputError(MavfiError):
    """Something the user gave is wrong: the text names what, where, its value and what is allowed (exit code 2)."""


class SpecMismatchError(BadInputError):
    """Two things that must belong together do not, e.g. a trained model and the stack that it should watch."""
