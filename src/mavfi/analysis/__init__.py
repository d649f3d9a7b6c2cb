"""Analysis of campaigns: `Runs` (one row per run) -> `View` -> `Table`.

`views_for(runs)` returns all tables of a report, `table(runs, name)` a single one.
"""

# Imports register the views, in the order of reports.
# isort: off
from mavfi.analysis import alarm_views  # noqa: F401
from mavfi.extras.ros import views as ros_views  # noqa: F401
from mavfi.extras.paper import failure_views  # noqa: F401
from mavfi.extras.firmware import views as firmware_views  # noqa: F401
from mavfi.analysis import flight_views, kernel_views  # noqa: F401
from mavfi.extras.paper import overhead_claims, mission_claims  # noqa: F401
from mavfi.extras.paper import views as paper_views  # noqa: F401
from mavfi.extras.paper import platform_claims, platform_views, redundancy_views  # noqa: F401
from mavfi.extras.bench import views as bench_views  # noqa: F401

# isort: on
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import Column, Table
from mavfi.analysis.views import VIEWS, View, register, table, table_asked_for, views_for

__all__ = ["VIEWS", "Column", "Runs", "Table", "View", "register", "table", "table_asked_for", "views_for"]
