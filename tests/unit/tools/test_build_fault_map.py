import polars as pl

from mavfi.campaign.analysis.runs import Runs
from tools import build_fault_map

ABOUT = {"profile": "published", "environments": ["dense"], "missions": 2, "seeds": [0, 1],
         "versions": {"mavfi": "1.0"}, "digest": "0123456789abcdef0"}  # fmt: skip


def runs():
    rows = [
        {"kind": "golden", "target": "", "world": f"dense/{seed}", "judged": True, "success": True, "inflation": None,
         "weight": 1.0}
        for seed in range(2)
    ]  # fmt: skip
    rows += [
        {"kind": "injected", "target": target, "world": f"dense/{seed}", "judged": True, "success": success,
         "inflation": inflation, "weight": 1.0}
        for target, seed, success, inflation in (
            ("way-point position \u00b7 sign", 0, False, None), ("way-point position \u00b7 sign", 1, True, 0.25),
            ("voxel \u00b7 sign", 0, True, 0.0), ("voxel \u00b7 sign", 1, True, 0.01),
        )
    ]  # fmt: skip
    return Runs(pl.DataFrame(rows, infer_schema_length=None), {}, ABOUT)


def test_the_page_has_a_row_for_every_site():
    page = build_fault_map.page(runs(), "2026-11-20")
    assert page.startswith("<!-- Written by `make results NAME=fault-map`; do not edit. -->\n\n# Fault map")
    assert "dense, 2 missions (seeds 0 to 1), 2026-11-20, mavfi 1.0, digest `0123456789abcdef`." in page
    assert "| way-point position \u00b7 sign | 2 | 50 [9, 91] | 100 [34, 100] | +25 % |" in page
    assert "| voxel \u00b7 sign | 2 | 0 [0, 66] | 0 [0, 66] | +1 % |" in page


def test_key_lines_leave_the_other_sites_out():
    lines = build_fault_map.key_lines(build_fault_map.page(runs(), "2026-11-20"))
    assert "way-point position" in lines and "voxel" not in lines and lines.startswith("Autopilot profile `published`")


def test_a_folder_without_a_ledger_is_refused(tmp_path, capsys):
    assert build_fault_map.main(tmp_path / "none") == 2
    assert "run `make results NAME=fault-map`" in capsys.readouterr().err
