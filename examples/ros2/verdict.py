"""Verdict on a run of the limiter: whether both joints end where they should."""

GOAL = (1.75, -2.0)


def reached(outputs):
    """True if the last positions on /out are those of the goal, within 0.1 rad."""
    if not outputs["/out"]:
        return False
    last = outputs["/out"][-1]["position"]
    return all(abs(position - goal) < 0.1 for position, goal in zip(last, GOAL, strict=True))
