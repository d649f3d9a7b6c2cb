"""Results of `campaign.shrink` as text."""

from mavfi.campaign.shrink import Shrunk, Trial
from mavfi.levels.level import text_of
from mavfi.report.numbers import change

Lines = list[tuple[str, str]]
_WHAT = {"publications": "fewer wrong publications", "width": "one bit instead of several",
         "bit": "a bit that changes the value less"}  # fmt: skip


def lines(found: Shrunk) -> Lines:
    """Headings and sentences: the smallest fault, the original, steps, golden run."""
    rows = [("smallest", _trial(found.smallest)), ("original", _trial(found.original))]
    for place, step in enumerate(found.steps):
        heading = "steps" if place == 0 else ""
        end = "none loses the mission" if step.found is None else _trial(step.found)
        rows.append((heading, f"{_WHAT.get(step.what, step.what)}, {step.tried} tried: {end}"))
    golden = found.golden.log
    rows.append(("golden run", f"{golden.status.words} after {float(golden.column('time')[-1]):.2f} s"))
    return rows


def _trial(trial: Trial) -> str:
    text = text_of(trial.fault)
    end = f"{trial.status.replace('_', ' ')} after {trial.time_s:.2f} s"
    if trial.injection is None:
        return f"{text}: {end}"
    before, after = change(trial.injection.before, trial.injection.after)
    return f"{text}: {before} → {after}, {end}"
