"""Claims: statements of the paper, each tested on the runs of a campaign."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import holm
from mavfi.analysis.table import TEXT, Column, Table
from mavfi.errors import BadInputError
from mavfi.plugins import Catalogue


@dataclass(frozen=True, slots=True)
class Evidence:
    """Result of testing a claim."""

    here: str  # measured values, with intervals and n
    p_value: float | None  # two-sided; None = not testable with these runs
    supports: bool  # whether the measured difference has the claimed sign
    behind: tuple[str, ...] = ()  # ids of the tested runs


@dataclass(frozen=True, slots=True)
class Claim:
    """A testable statement of the paper."""

    name: str
    statement: str
    section: str  # of the paper
    campaign: str  # name of the campaign whose runs test it
    method: str  # the test, as shown in its table, whose notes explain it
    test: Callable[[Runs], Evidence]


CLAIMS: Mapping[str, Claim] = Catalogue("mavfi.claims")
"""By name."""
LEVEL = 0.05
"""Family-wise error rate: probability that any claim of a table is wrongly confirmed or contradicted."""
CONFIRMED, CONTRADICTED, UNDECIDED = "confirmed", "contradicted", "undecided"


def claims_table(names: Sequence[str], campaigns: Iterable[Runs]) -> Table:
    """Test each claim on its campaign, and tabulate the verdicts with Holm's correction over all claims.

    Raises:
        BadInputError: A name is not known.
    """
    unknown = next((name for name in names if name not in CLAIMS), None)
    if unknown is not None:
        raise BadInputError(f"claim {unknown!r}: not known; allowed: {', '.join(CLAIMS)}")
    runs = {own.campaign["name"]: own for own in campaigns}
    claims = [CLAIMS[name] for name in names]
    tested = [_tested(claim, runs.get(claim.campaign)) for claim in claims]
    adjusted = holm([one.p_value for one in tested])
    rows = [
        (claim.name, claim.statement, verdict(one, corrected), claim.section, one.here, one.p_value, corrected,
         claim.method, claim.campaign)
        for claim, one, corrected in zip(claims, tested, adjusted, strict=True)
    ]  # fmt: skip
    count = sum(p is not None for p in adjusted)
    return Table(
        "claims", "Findings of the paper, tested", _COLUMNS, rows, keys=2,
        notes=(
            f"confirmed, contradicted: two-sided p below {LEVEL:g} after Holm's correction over {count} tests (Holm "
            "1979), in or against the direction of the claim; undecided: at this n the data are compatible with both",
            "p: two-sided, by the test in the row; randomization of worlds: random signs of the differences of worlds, "
            "or, of groups of different worlds, worlds shuffled; flights of one world are not taken as independent",
            "exact sign test, for measured overheads: of timed golden flights, each taken as independent; none: the "
            "output of a model, which has no p",
            "[95 % interval]: of rates Wilson's, n reduced by the design effect of worlds; of other means a bootstrap "
            "of worlds",
            "published autopilot profile, faults and platforms of this project: see the fidelity page for differences",
        ),
        behind=[tuple(one.behind if key in _LINKED else () for key in _KEYS) for one in tested],
    )  # fmt: skip


_COLUMNS = (
    Column("claim", "claim", TEXT, hidden=True), Column("statement", "the paper"), Column("verdict", "verdict"),
    Column("section", "section"), Column("here", "here"), Column("p", "p", "number .2g"),
    Column("holm_p", "p (Holm)", "number .2g"), Column("method", "test"),
    Column("campaign", "campaign", TEXT, hidden=True),
)  # fmt: skip
_KEYS, _LINKED = tuple(column.key for column in _COLUMNS), ("verdict", "p", "holm_p")
"""Columns, and those whose cells open the tested runs."""


def _tested(claim: Claim, runs: Runs | None) -> Evidence:
    if runs is None or not len(runs):
        return Evidence(f"no runs of campaign {claim.campaign}", None, supports=False)
    return claim.test(runs)


def verdict(one: Evidence, corrected: float | None) -> str:
    """Verdict (confirmed, contradicted or undecided) from the corrected p value."""
    if corrected is None or corrected >= LEVEL:
        return UNDECIDED
    return CONFIRMED if one.supports else CONTRADICTED
