import polars as pl

from mavfi.analysis.runs import Runs
from tools import build_fault_map, results


def runs():
    rows = [
        {
            "kind": "golden",
            "target": "",
            "world": f"dense/{seed}",
            "judged": True,
            "success": True,
            "inflation": None,
            "weight": 1.0,
        }
        for seed in range(2)
    ]
    rows += [
        {
            "kind": "injected",
            "target": target,
            "world": f"dense/{seed}",
            "judged": True,
            "success": success,
            "inflation": inflation,
            "weight": 1.0,
        }
        for target, seed, success, inflation in (
            ("way-point position · sign", 0, False, None),
            ("way-point position · sign", 1, True, 0.25),
            ("path vertex · sign", 0, True, 0.0),
            ("path vertex · sign", 1, True, 0.01),
            ("voxel · sign", 0, True, 0.0),
            ("voxel · sign", 1, True, 0.01),
        )
    ]
    return Runs(pl.DataFrame(rows, infer_schema_length=None))


def test_the_table_has_every_site_and_the_page_the_harmful_ones(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(results, "RESULTS", results.ROOT / "out")
    monkeypatch.setattr(results, "TABLES", tmp_path)
    written = {}
    monkeypatch.setattr(results, "write", lambda *given: written.update(given[3], shown=given[4]) or results.ROOT / "p")
    build_fault_map.write_page(build_fault_map.fault_table(runs()), [])
    page = written["shown"][0].markdown(written["sites"])
    assert len(written["sites"].rows) == 3
    assert "| way-point position · sign | 50.0 [9.5, 90.5] 1/2 | 100.0 [34.2, 100.0] 2/2 | +25.0 % |" in page
    assert "| voxel · sign | 0.0 [0.0, 65.8] 0/2 | 0.0 [0.0, 65.8] 0/2 | +1.0 % |" in page and "path vertex" not in page
