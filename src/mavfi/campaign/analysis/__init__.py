"""Analysis of campaigns: `Runs` (one row per run) -> `View` -> `Table`.

`views_for(runs)` returns all tables of a report, `table(runs, name)` a single one.
"""

from mavfi.campaign.analysis import (  # noqa: F401  (imports register the views, in the order of reports)
    alarm_views,
    external_views,
    failure_views,
    firmware_views,
    flight_views,
    kernel_views,
    overhead_claims,
    paper_claims,
    paper_views,
    platform_claims,
    platform_views,
    redundancy_views,
    scheme_views,
)  # fmt: skip
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import Column, Table
from mavfi.campaign.analysis.views import VIEWS, View, register, table, table_asked_for, views_for

__all__ = ["VIEWS", "Column", "Runs", "Table", "View", "register", "table", "table_asked_for", "views_for"]
