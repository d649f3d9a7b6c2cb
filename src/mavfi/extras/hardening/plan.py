"""Protection plans: what is protected in each compiled function, and at which measured price.  Frozen data in YAML.

A plan holds for the IR from which it was made (`ir_sha256`), the same on every x86-64 machine.  Times were measured on
one processor; they are data, since they are charged to the latency of the simulated platform.
"""

import hashlib
import re
import textwrap
from collections.abc import Collection, Sequence
from functools import partial
from importlib.metadata import version
from itertools import groupby
from operator import not_
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml
from pydantic import (
    Field,
    NonNegativeInt,
    field_serializer,
    field_validator,
    model_validator,
)

from mavfi.config import Config, load, shipped
from mavfi.errors import BadInputError, write_text
from mavfi.version import __version__

Kind = Literal["duplicate", "none"]
_RANGES = re.compile(r"(\d+):(\d+(?:-\d+)?(?:,\d+(?:-\d+)?)*)")
_LINE = 100
_MOST = 1_000_000
"""Largest number of a block or an offset."""


class Site(NamedTuple):
    """A static instruction with a result, in the parsed module of a kernel.

    The numbers count from 0: `function` in `Module.functions`, `block` in `Function.blocks`, `offset` in `Block.sites`.
    """

    function: int
    block: int
    offset: int


class Coverage(Config):
    """Share of the silent data corruptions per call that are removed, with its 95 % interval."""

    estimate: float = Field(le=1)
    low: float = Field(le=1)
    high: float = Field(le=1)

    @model_validator(mode="after")
    def _ordered(self) -> "Coverage":
        if not self.low <= self.estimate <= self.high:
            raise ValueError(f"coverage {self.estimate}: not in its interval {self.low} to {self.high}")
        return self


def _is_none(value: Any) -> bool:
    """Whether an optional value is left out: a plan without it has the digest that it had before there was any."""
    return value is None


class FunctionPlan(Config):
    """Protection of one compiled function for one signature."""

    kernel: str = Field(description="kernel of the pipeline that calls it, as in instruction faults")
    function: str = Field(description="module and name")
    signature: str = Field(description="Numba types of the arguments, see `signature_text`")
    ir_sha256: str = Field(pattern="^[0-9a-f]{64}$", description="digest of the plain IR")
    kind: Kind = Field("duplicate", description="duplicate: of sites; none")
    addresses: bool = Field(False, description="addresses are compared before loads, too")
    libm: Literal[False] = Field(False, description="calls of libm are not duplicated")
    sites: tuple[Site, ...] = Field((), description="by function: blocks with offsets, e.g. {0: '0:0-3,5 2:1'}")
    lines: tuple[str, ...] = Field((), description="source lines of the sites, file:line, for readers")
    time: float = Field(1.0, ge=1, le=100, description="protected / plain execution time, measured")
    share: float | None = Field(
        None, ge=0, le=1, exclude_if=_is_none, description="of its kernel's plain execution time; absent = not known"
    )
    predicted: Coverage | None = Field(None, description="coverage predicted from injections in recorded calls")
    certified: Coverage | None = Field(
        None, exclude_if=_is_none, description="coverage measured with fresh missions and faults"
    )

    @field_validator("sites", mode="before")
    @classmethod
    def _expanded(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        return tuple(site for number, text in given.items() for site in _expand(number, text))

    @field_validator("sites")
    @classmethod
    def _sorted(cls, sites: tuple[Site, ...]) -> tuple[Site, ...]:
        return tuple(sorted(set(sites)))

    @field_serializer("sites")
    def _compact(self, sites: tuple[Site, ...]) -> dict[int, str]:
        return {number: " ".join(_ranges(list(own))) for number, own in groupby(sites, key=lambda site: site.function)}

    @model_validator(mode="after")
    def _consistent(self) -> "FunctionPlan":
        if self.sites and self.kind != "duplicate":
            raise ValueError(f"kind {self.kind!r}: {len(self.sites)} sites; allowed: sites with kind duplicate only")
        return self


class Plan(Config):
    """A protection plan.

    `functions` has at most one entry for a function and signature; other functions are not protected.
    """

    mavfi: str = Field(__version__, description="version that made the plan")
    numba: str = Field(default_factory=partial(version, "numba"))
    llvmlite: str = Field(default_factory=partial(version, "llvmlite"))
    cpu: str = Field("", description="class of the processor on which times were measured")
    ledger: str = Field("", description="digest of the ledger whose missions were studied")
    studied: dict[str, tuple[NonNegativeInt, NonNegativeInt]] = Field(
        {}, exclude_if=not_, description="their first and last seed, by environment"
    )
    budget: float | None = Field(
        None, ge=0, exclude_if=_is_none, description="largest share of a flight's kernel time that it was to add"
    )
    functions: tuple[FunctionPlan, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> "Plan":
        for environment, (first, last) in self.studied.items():
            if last < first:
                raise ValueError(f"studied.{environment}: {first}, {last}: allowed: ascending")
        seen = set()
        for one in self.functions:
            if (one.function, one.signature) in seen:
                raise ValueError(f"functions: {one.function!r} ({one.signature}): planned twice; allowed: once")
            seen.add((one.function, one.signature))
        return self

    @property
    def bare(self) -> "Plan":
        """The plan without what flights do not depend on: lines, coverage, and functions that are left as they are."""
        nothing = {"lines": (), "predicted": None, "certified": None}
        functions = tuple(
            one.model_copy(update=nothing) for one in self.functions if one.kind != "none" or one.time > 1.0
        )
        return self.model_copy(update={"functions": functions, "studied": {}, "budget": None})

    def has_studied(self, environment: str, seed: int) -> bool:
        """Whether its choice has seen a mission; of environments that it does not list it has seen none."""
        first, last = self.studied.get(environment, (0, -1))
        return first <= seed <= last

    @property
    def digest(self) -> str:
        """SHA-256 of the bare content, which identifies the plan; modules of functions are not part of it."""
        bare = self.bare
        functions = [one.model_copy(update={"function": one.function.rpartition(".")[2]}) for one in bare.functions]
        content = bare.model_copy(update={"functions": tuple(functions)})
        return hashlib.sha256(content.model_dump_json().encode()).hexdigest()

    def time_of(self, kernel: str) -> float:
        """Protected / plain execution time of a kernel, 1 if none of its functions is protected.

        The times of its functions are weighted by their shares of its time; without shares it is the largest one.
        """
        own = [one for one in self.functions if one.kernel == kernel]
        if any(one.share is None for one in own):
            return max(one.time for one in own)
        return 1.0 + sum((one.share or 0.0) * (one.time - 1.0) for one in own)

    def find(self, function: str, signature: tuple[Any, ...]) -> FunctionPlan | None:
        """The entry for a function (module and name) and the Numba types of its arguments; None = not protected."""
        text = signature_text(signature)
        return next((one for one in self.functions if (one.function, one.signature) == (function, text)), None)

    def check_versions(self) -> None:
        """Raise a BadInputError if the plan was made with another compiler, which makes other code."""
        for package, planned in (("numba", self.numba), ("llvmlite", self.llvmlite)):
            here = version(package)
            if here != planned:
                raise BadInputError(f"protection: planned with {package} {planned}, this is {here}; make it again")


def signature_text(signature: tuple[Any, ...]) -> str:
    """Numba types of arguments as in a plan."""
    return ", ".join(map(str, signature))


def check_code(plan: FunctionPlan, ir_sha256: str, sites: Sequence[Sequence[int]]) -> None:
    """Check that a function has the IR for which its protection was planned.

    Args:
        plan: Its protection.
        ir_sha256: Digest of its IR.
        sites: Number of sites of each block, by function of the module.

    Raises:
        BadInputError: It has other IR, or lacks a planned site.
    """
    if plan.ir_sha256 != ir_sha256:
        raise BadInputError(
            f"protection of {plan.function}: planned for IR {plan.ir_sha256[:12]}, this is {ir_sha256[:12]}: source, "
            "numba or llvmlite differ; make the plan again with mavfi harden"
        )
    for site in plan.sites:
        blocks = sites[site.function] if site.function < len(sites) else ()
        if site.block >= len(blocks) or site.offset >= blocks[site.block]:
            raise BadInputError(
                f"protection of {plan.function}: site {site.block}:{site.offset} of function {site.function}: not in "
                "its code; make the plan again with mavfi harden"
            )


def load_plan(name: str | Path) -> Plan:
    """Read a plan from a path, or a shipped one by name.

    Raises:
        BadInputError: The file does not exist or is invalid; one line.
    """
    if isinstance(name, Path):
        return load(Plan, name)
    return shipped("protections", Plan, name)


def save_plan(plan: Plan, path: Path) -> None:
    """Write a plan as YAML.

    Raises:
        BadInputError: The file cannot be written.
    """
    content = plan.model_dump(mode="json", exclude_defaults=True)
    content = {key: getattr(plan, key) for key in ("mavfi", "numba", "llvmlite", "cpu", "ledger")} | content
    text = yaml.dump(content, sort_keys=False, width=_LINE, allow_unicode=True)
    write_text(path, text)


def _expand(number: Any, text: Any) -> list[Site]:
    """Sites of function `number` from e.g. "0:0-3,5 2:1"."""
    if not str(number).isdecimal() or not isinstance(text, str):
        raise ValueError(f"{number!r}: {textwrap.shorten(repr(text), 60)}; allowed: e.g. {{0: '0:0-3,5 2:1'}}")
    function = int(number)
    found = []
    for part in text.split():
        match = _RANGES.fullmatch(part)
        if match is None:
            raise ValueError(f"{part!r}: not understood; allowed: block:offsets, e.g. 2:0-3,5")
        for span in match[2].split(","):
            first, _, last = span.partition("-")
            block = int(match[1])
            low = int(first)
            high = int(last or first)
            if max(block, low, high) > _MOST or high < low:
                raise ValueError(f"{part!r}: allowed: ascending numbers up to {_MOST:,}")
            found += [Site(function, block, offset) for offset in range(low, high + 1)]
    return found


def _ranges(sites: Collection[Site]) -> list[str]:
    """Inverse of `_expand`, one text per block."""
    found = []
    for block, own in groupby(sites, key=lambda site: site.block):
        spans: list[list[int]] = []
        for site in own:
            if spans and site.offset == spans[-1][1] + 1:
                spans[-1][1] = site.offset
            else:
                spans.append([site.offset, site.offset])
        found.append(f"{block}:" + ",".join(f"{low}" if low == high else f"{low}-{high}" for low, high in spans))
    return found
