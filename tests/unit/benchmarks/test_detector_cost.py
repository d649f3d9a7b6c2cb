"""The table of the cost of detection keeps those of other processors."""

from benchmarks import detectors


def test_tables_of_other_processors_stay_and_the_own_one_is_replaced(monkeypatch):
    monkeypatch.setattr(detectors, "processor", lambda: "one")

    def table(processor, value):
        return f"4 missions of each profile (dense), 5 repeats; {processor}, load 1.0.\n\n| a |\n|---|\n| {value} |"

    earlier = f"\n{table('two', 2)}\n\n{table('one', 1)}\n"
    found = detectors.with_others(table("one", 3), earlier)
    assert found == f"{table('one', 3)}\n\n{table('two', 2)}"
    assert detectors.with_others(table("one", 4), "\n") == table("one", 4)
