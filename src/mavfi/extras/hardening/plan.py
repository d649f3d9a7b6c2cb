"""Protection plans: what is protected in each compiled function, and at which measured price.  Frozen data in YAML.

A plan holds for the IR from which it was made (`ir_sha256`), the same on every x86-64 machine.  Times were measured on
one processor; they are data, since they are charged to the latency of the simulated platform.
"""

import re
import textwrap
from collections.abc import Collection, Sequence
from functools import partial
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml
from pydantic import Field, field_serializer, field_validator, model_validator

from mavfi.config import Config, load, shipped
from mavfi.errors import BadInputError, write_text
from mavfi.version import __version__

Kind = Literal["duplicate", "none"]
_RANGES = re.compile(r"(\d+):(\d+(?:-\d+)?(?:,\d+(?:-\d+)?)*)")
_LINE_WIDTH = 100
_MAX_NUMBER = 1_000_000
"""Largest number of a block or an offset."""


class ModuleSite(NamedTuple):
    """A static instruction with a result, in the parsed module of a kernel.

    The numbers count from 0: `function` in `Module.functions`, `block` in `Function.blocks`, `offset` in `Block.sites`.
    """

    function: int
    block: int
    offset: int


class FunctionKey(NamedTuple):
    """A compiled function, as in a plan.

    Attributes:
        function: Module and name.
        signature: Numba types of the arguments, see `signature_text`.
    """

    function: str
    signature: str


def _is_none(value: Any) -> bool:
    """Whether an optional value is left out of the JSON: plans without it keep the digest of older versions."""
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
    sites: tuple[ModuleSite, ...] = Field((), description="by function: blocks with offsets, e.g. {0: '0:0-3,5 2:1'}")
    lines: tuple[str, ...] = Field((), description="source lines of the sites, file:line, for readers")
    time: float = Field(1.0, ge=1, le=100, description="protected / plain execution time, measured")
    share: float | None = Field(
        None, ge=0, le=1, exclude_if=_is_none, description="of its kernel's plain execution time; absent = not known"
    )
    predicted: float | None = Field(
        None, ge=0, le=1, description="share of its silent corruptions that this removes, by the faults of the ledger"
    )

    @property
    def key(self) -> FunctionKey:
        """Its function and signature."""
        return FunctionKey(self.function, self.signature)

    @field_validator("sites", mode="before")
    @classmethod
    def _expanded(cls, sites: Any) -> Any:
        if not isinstance(sites, dict):
            return sites
        return tuple(site for number, text in sites.items() for site in _expand(number, text))

    @field_validator("sites")
    @classmethod
    def _sorted(cls, sites: tuple[ModuleSite, ...]) -> tuple[ModuleSite, ...]:
        return tuple(sorted(set(sites)))

    @field_serializer("sites")
    def _compact(self, sites: tuple[ModuleSite, ...]) -> dict[int, str]:
        by_function = groupby(sites, key=lambda site: site.function)
        return {number: " ".join(_ranges(list(in_function))) for number, in_function in by_function}

    @model_validator(mode="after")
    def _consistent(self) -> "FunctionPlan":
        if self.sites and self.kind != "duplicate":
            raise ValueError(f"kind {self.kind!r}: {len(self.sites)} sites; allowed: sites with kind duplicate only")
        return self


class ProtectionPlan(Config):
    """A protection plan.

    `functions` has at most one entry for a function and signature; other functions are not protected.
    """

    mavfi: str = Field(__version__, description="version that made the plan")
    numba: str = Field(default_factory=partial(version, "numba"))
    llvmlite: str = Field(default_factory=partial(version, "llvmlite"))
    cpu: str = Field("", description="class of the processor on which times were measured")
    ledger: str = Field("", description="digest of the ledger whose missions were studied")
    budget: float | None = Field(
        None, ge=0, exclude_if=_is_none, description="largest share of a flight's kernel time that it was to add"
    )
    functions: tuple[FunctionPlan, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> "ProtectionPlan":
        seen = set()
        for planned in self.functions:
            if planned.key in seen:
                raise ValueError(f"functions: {planned.function!r} ({planned.signature}): planned twice; allowed: once")
            seen.add(planned.key)
        return self

    @property
    def bare(self) -> "ProtectionPlan":
        """The plan without what flights do not depend on: lines, prediction, functions that are left as they are."""
        nothing = {"lines": (), "predicted": None}
        functions = tuple(
            planned.model_copy(update=nothing)
            for planned in self.functions
            if planned.kind != "none" or planned.time > 1.0  # a time above 1 is charged even without sites
        )
        return self.model_copy(update={"functions": functions, "budget": None})

    def time_of(self, kernel: str) -> float:
        """Protected / plain execution time of a kernel, 1 if none of its functions is protected.

        The times of its functions are weighted by their shares of its time; without shares it is the largest one.
        """
        functions = [planned for planned in self.functions if planned.kernel == kernel]
        if any(planned.share is None for planned in functions):
            return max(planned.time for planned in functions)
        return 1.0 + sum((planned.share or 0.0) * (planned.time - 1.0) for planned in functions)

    def find(self, function: str, signature: tuple[Any, ...]) -> FunctionPlan | None:
        """The entry for a function (module and name) and the Numba types of its arguments; None = not protected."""
        key = FunctionKey(function, signature_text(signature))
        return next((planned for planned in self.functions if planned.key == key), None)

    def check_versions(self) -> None:
        """Raise a BadInputError if the plan was made with another compiler, which makes other code."""
        for package, planned in (("numba", self.numba), ("llvmlite", self.llvmlite)):
            installed = version(package)
            if installed != planned:
                raise BadInputError(f"protection: planned with {package} {planned}, this is {installed}; make it again")


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
        blocks: Sequence[int] = ()  # a function that the module does not have has no blocks
        if site.function < len(sites):
            blocks = sites[site.function]
        if site.block >= len(blocks) or site.offset >= blocks[site.block]:
            raise BadInputError(
                f"protection of {plan.function}: site {site.block}:{site.offset} of function {site.function}: not in "
                "its code; make the plan again with mavfi harden"
            )


def load_plan(name: str | Path) -> ProtectionPlan:
    """Read a plan from a path, or a shipped one by name.

    Raises:
        BadInputError: The file does not exist or is invalid; one line.
    """
    if isinstance(name, Path):
        return load(ProtectionPlan, name)
    return shipped("protections", ProtectionPlan, name)


def save_plan(plan: ProtectionPlan, path: Path) -> None:
    """Write a plan as YAML.

    Raises:
        BadInputError: The file cannot be written.
    """
    content = plan.model_dump(mode="json", exclude_defaults=True)
    content = {key: getattr(plan, key) for key in ("mavfi", "numba", "llvmlite", "cpu", "ledger")} | content
    text = yaml.dump(content, sort_keys=False, width=_LINE_WIDTH, allow_unicode=True)
    write_text(path, text)


def _expand(number: Any, text: Any) -> list[ModuleSite]:
    """Sites of function `number` from e.g. "0:0-3,5 2:1"."""
    if not str(number).isdecimal() or not isinstance(text, str):
        raise ValueError(f"{number!r}: {textwrap.shorten(repr(text), 60)}; allowed: e.g. {{0: '0:0-3,5 2:1'}}")
    function = int(number)
    sites = []
    for part in text.split():
        match = _RANGES.fullmatch(part)
        if match is None:
            raise ValueError(f"{part!r}: not understood; allowed: block:offsets, e.g. 2:0-3,5")
        for span in match[2].split(","):
            first, _, last = span.partition("-")
            block = int(match[1])
            low = int(first)
            high = int(last or first)
            if max(block, low, high) > _MAX_NUMBER or high < low:
                raise ValueError(f"{part!r}: allowed: ascending numbers up to {_MAX_NUMBER:,}")
            sites += [ModuleSite(function, block, offset) for offset in range(low, high + 1)]
    return sites


def _ranges(sites: Collection[ModuleSite]) -> list[str]:
    """Inverse of `_expand`, one text per block."""
    texts = []
    for block, in_block in groupby(sites, key=lambda site: site.block):
        offsets = [site.offset for site in in_block]
        spans = []
        # offset - position is the same within a run without a gap
        for _, run in groupby(enumerate(offsets), key=lambda numbered: numbered[1] - numbered[0]):
            first, *others = (offset for _, offset in run)
            span = f"{first}"
            if others:
                span += f"-{others[-1]}"
            spans.append(span)
        texts.append(f"{block}:{','.join(spans)}")
    return texts
