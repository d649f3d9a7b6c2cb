"""What a ledger says: rates of instructions from few faults, what its faults lost, and the campaign of the proof."""

import polars as pl
import pytest

from mavfi.analysis.rows import SCHEMA
from mavfi.analysis.runs import Runs
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.extras.hardening.ledger import CorruptionRates, HardeningLedger, groups_of
from mavfi.ir.injection.table import InjectionSite
from mavfi.ir.metadata import Frame

SITE = InjectionSite(0, 3, "fmul", "double", 64, "floating_point", (Frame("m/f.py", 9, ""),))


def fault(line, opcode="fmul"):
    return groups_of(opcode, "double", "m/f.py", line, "floating_point")


def test_a_rate_is_shrunk_to_that_of_the_opcode_and_this_to_that_of_all():
    rates = CorruptionRates([(fault(8), True), (fault(9), True), (fault(9), False), (fault(2, "fadd"), False)])
    opcode = (2 + 4 * 2 / 4) / (3 + 4)
    assert rates.of(SITE) == pytest.approx((1 + 4 * opcode) / (2 + 4))


def test_many_faults_in_its_line_outweigh_other_lines():
    rates = CorruptionRates([*[(fault(8), False)] * 50, *[(fault(9), True)] * 1000])
    assert rates.of(SITE) > 0.98
    assert CorruptionRates([]).of(SITE) == 0.0


def ledger(tmp_path, effects, kernels=("pid",)):
    """A ledger of faults in pid with these effects on kernel and flight, of which silent ones lose the mission."""
    rows = [
        {
            "run_id": f"{number}",
            "kind": "injected",
            "setting": "fi",
            "arm": "",
            "level": "instruction",
            "kernel": "pid",
            "kernel_effect": effect,
            "effect": effect,
            "judged": True,
            "site_outcome": "activated",
            "success": effect != "sdc",
            "golden_success": True,
            "world": f"{number}",
            "population": "all_bits",
            "weight": 1.0,
        }
        for number, effect in enumerate(effects)
    ]
    hardening_ledger = HardeningLedger(tmp_path, load_campaign("hardening"), "0" * 64, kernels)
    frame = pl.DataFrame(rows, schema={name: kind for name, kind in SCHEMA.items() if name in rows[0]})
    hardening_ledger.__dict__["_runs"] = Runs(frame, {}, {})
    return hardening_ledger


def test_losses_and_proof(tmp_path):
    losses = ledger(tmp_path, ["sdc", "masked", "masked", "crash"])
    assert losses.losses == (1, 1, 1, 0)
    proof = parse(Campaign, losses.proof(tmp_path / "plan.yaml"), "proof")
    assert proof.require == ("protected: sdc < 25.0 %",)
    assert proof.first_seed == 10_008 and proof.sampling.kernels == ("pid",)
    assert proof.mission == losses.campaign.mission and list(proof.arms) == ["protected"]


def test_nothing_is_proved_without_a_silent_corruption_and_nothing_chosen_without_a_fault(tmp_path):
    with pytest.raises(BadInputError, match="no fault is a silent corruption"):
        ledger(tmp_path, ["masked", "crash"]).proof(tmp_path / "plan.yaml")
    with pytest.raises(BadInputError, match="mavfi campaign run` flies the rest"):
        ledger(tmp_path, ["masked"], kernels=("octomap",)).losses  # noqa: B018
