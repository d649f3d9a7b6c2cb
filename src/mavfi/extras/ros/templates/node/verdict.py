"""When a run of the node counts as a success."""


def is_slow_enough(outputs):
    """True if no command on /cmd_out is faster than 1 m/s; `outputs`: the messages of each topic, in order."""
    return bool(outputs["/cmd_out"]) and all(abs(message["linear"]["x"]) <= 1.0 for message in outputs["/cmd_out"])
