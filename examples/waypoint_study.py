"""A small study with the Python API: what does one wrong bit in a way-point do, and does GAD bring the missions back?

python examples/waypoint_study.py [FOLDER]
"""

import sys

import polars as pl

import mavfi


def main(folder: str = "out/waypoint_study") -> None:
    campaign = mavfi.Campaign.model_validate(
        {
            "name": "waypoint_study",
            "mission": {"wind": 1.0},
            "environments": ["sparse"],
            "missions": 2,
            "null_runs": 0,
            "faults": 12,
            "sampling": {
                "scheme": "groups",
                "groups": [{"name": "way-point", "sites": ["planning.waypoint.x", "planning.waypoint.y"]}],
            },
            "arms": {"gaussian": {"detector": "gaussian"}},
        }
    )
    runs = mavfi.run(campaign, folder)
    judged = runs.injected.frame.group_by("setting", "effect").agg(pl.len(), pl.col("success").mean())
    print(judged.sort("setting", "effect"))
    success = mavfi.table(runs, "success").frame
    print(success.select("environment", "setting", "success", "success_low", "success_high", "success_n"))
    mavfi.figure(runs, "success").savefig(f"{folder}/success.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
