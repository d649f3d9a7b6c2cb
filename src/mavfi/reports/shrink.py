"""Results of `campaign.shrink` as text and as plain data."""

from typing import Any

from mavfi.campaign.samplers.request import text_of
from mavfi.campaign.shrink import Shrunk, Trial
from mavfi.reports.text import change

Lines = list[tuple[str, str]]
_WHAT = {"publications": "fewer wrong publications", "width": "one bit instead of several",
         "bit": "a bit that changes the value less"}  # fmt: skip


def lines(found: Shrunk) -> Lines:
    """Headings and sentences: the smallest fault, the original, steps, golden run."""
    rows = [("smallest", _trial(found.smallest)), ("original", _trial(found.original))]
    for place, step in enumerate(found.steps):
        heading = "steps" if place == 0 else ""
        end = "none loses the mission" if step.found is None else _trial(step.found)
        rows.append((heading, f"{_WHAT[step.what]}, {step.tried} tried: {end}"))
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


def to_json(found: Shrunk) -> dict[str, Any]:
    """Plain data: run, faults, steps."""
    return {
        "run_id": found.spec.run_id, "smallest": _plain(found.smallest), "original": _plain(found.original),
        "steps": [
            {"what": step.what, "tried": step.tried, "found": None if step.found is None else _plain(step.found)}
            for step in found.steps
        ],
    }  # fmt: skip


def _plain(trial: Trial) -> dict[str, Any]:
    injection = trial.injection
    return {
        "fault": trial.fault.to_json(), "text": text_of(trial.fault), "status": trial.status, "lost": trial.lost,
        "time_s": trial.time_s, "before": None if injection is None else injection.before,
        "after": None if injection is None else injection.after,
    }  # fmt: skip
