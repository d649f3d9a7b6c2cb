"""Analysis of campaigns: `Runs` (one row per run) -> `View` -> `Table`.

`views_for(runs)` returns all tables of a report, `table(runs, name)` a single one.
"""

from mavfi.analysis.runs import Runs
from mavfi.analysis.table import Column, Table
from mavfi.analysis.views import VIEWS, View, table, table_asked_for, views_for

__all__ = ["VIEWS", "Column", "Runs", "Table", "View", "table", "table_asked_for", "views_for"]
