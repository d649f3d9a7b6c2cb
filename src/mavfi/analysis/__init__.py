"""Analysis of campaigns: `Runs` (one row per run) -> `View` -> `Table`; statistics with intervals."""
