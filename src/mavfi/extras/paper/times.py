"""Breakdown of a study's time: wall time by step, and worker time from the ledgers of its campaigns."""

from collections.abc import Mapping

from mavfi.analysis.runs import Runs
from mavfi.analysis.table import PERCENT, Column, Table
from mavfi.extras.paper.steps import FLIGHTS, SET_UP

_MINUTES = "number .1f min"


def step_table(seconds: Mapping[str, float], campaigns: Mapping[str, Runs]) -> Table:
    """Wall time (s) by step, with the runs per second of the campaigns, and the sum."""
    whole = sum(seconds.values())
    runs = {FLIGHTS: sum(map(len, campaigns.values()))}
    rows = [
        (step, spent / 60, spent / whole if whole else None, runs[step] / spent if step in runs and spent else None)
        for step, spent in [*seconds.items(), ("all", whole)]
    ]
    columns = (
        Column("step", "step"), Column("wall", "wall time", _MINUTES), Column("share", "share", PERCENT),
        Column("pace", "runs per second", "number .1f"),
    )  # fmt: skip
    return Table(
        "steps", "Where the time goes: steps of mavfi reproduce", columns, rows if seconds else (),
        notes=(
            "wall time, added over the runs of a resumed study; that of flights includes drawing their faults and "
            "writing the ledgers; compilation: of what was not in the cache",
            *((f"{SET_UP}: once, also if it was for another study",) if SET_UP in seconds else ()),
            "report.html is written last, so that its own time is in study.md only",
        ),
    )  # fmt: skip


def time_table(campaigns: Mapping[str, Runs]) -> Table:
    """Number of runs and worker time by campaign and in total; those together include null runs."""
    rows = [_row(str(runs.campaign["name"]), [runs]) for runs in campaigns.values()]
    rows.append(_row("all", list(campaigns.values())))
    return Table(
        "times", "Where the time goes: workers of the campaigns", _COLUMNS, rows,
        notes=(
            "time of worker processes, added over workers: with two workers about twice the wall time; golden runs "
            "include the counting of instructions, those with a fault start at checkpoints of golden runs; a golden "
            "flight that campaigns share is in the time of the one that flew it; together: with null runs; pace: runs "
            "of a campaign per second and worker",
        ),
    )  # fmt: skip


_COLUMNS = (
    Column("campaign", "campaign"), Column("golden", "golden runs", "number"), Column("golden_s", "time", _MINUTES),
    Column("golden_mean_s", "each", "number .2f s"), Column("faulty", "with a fault", "number"),
    Column("faulty_s", "time", _MINUTES), Column("faulty_mean_s", "each", "number .2f s"),
    Column("all_s", "together", _MINUTES), Column("pace", "pace", "number .1f /s"),
)  # fmt: skip


def _row(name: str, parts: list[Runs]) -> tuple[object, ...]:
    golden = [wall for runs in parts for wall in runs.golden["wall_s"] if wall is not None]
    faulty = [wall for runs in parts for wall in runs.injected["wall_s"] if wall is not None]
    every = [wall for runs in parts for wall in runs["wall_s"] if wall is not None]
    return (
        name, len(golden), sum(golden) / 60, sum(golden) / len(golden) if golden else None,
        len(faulty), sum(faulty) / 60, sum(faulty) / len(faulty) if faulty else None, sum(every) / 60,
        len(every) / sum(every) if every else None,
    )  # fmt: skip
