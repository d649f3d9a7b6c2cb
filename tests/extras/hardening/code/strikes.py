"""Exhaustive injection: every bit of every dynamic instruction of a call."""

import mmap
from collections import Counter

from mavfi.extras.hardening.compiled import copied
from mavfi.extras.hardening.duplicate import candidates, protect
from mavfi.ir.build import environment_of, source_of
from mavfi.ir.forked import run_in_child
from mavfi.ir.injection.build import assemble
from mavfi.ir.injection.instrument import instrument
from mavfi.ir.injection.variant import Variant, signature_of
from mavfi.ir.parser import parse_module
from mavfi.levels.instruction.api import digest
from mavfi.levels.instruction.plan import budget_for

OUTCOMES = {b"M": "masked", b"S": "sdc", b"D": "detected", b"E": "exception"}


class Full:
    """Duplicates every instruction that can be."""

    key = b"full"

    def __init__(self, *, addresses=False):
        self.addresses = addresses

    def __call__(self, module):
        return protect(module, candidates(module), addresses=self.addresses)


def module_of(kernel, args):
    return parse_module(source_of(kernel, signature_of(args)).text, "kernel")


def variant(kernel, args, rewrite=None):
    """The instrumented variant, built in this process."""
    signature = signature_of(args)
    source = source_of(kernel, signature)
    built = assemble(instrument(source.text, source.kernel, rewrite), source)
    return Variant(built, environment_of(kernel, signature))


def sites_of(struck, args):
    """The site of each dynamic instruction of a call."""
    total = struck.count(*copied(args))[1]
    return struck.resolve(range(total), *copied(args))[1]


def strike_all(struck, args, step=1):
    """Outcomes of all faults, or of every `step`-th: number by outcome, and the sites of silent corruptions."""
    sites = sites_of(struck, args)
    todo = [(index, bit) for index, site in enumerate(sites) for bit in range(site.width)][::step]
    arguments = copied(args)
    golden = digest((struck.count(*arguments)[0], arguments))
    budget = budget_for(len(sites))
    outcomes = mmap.mmap(-1, len(todo) + 1)
    hows = []
    while len(hows) < len(todo):
        first = len(hows)

        def work(first=first):
            for place, (index, bit) in enumerate(todo[first:], first):
                outcomes[place] = outcome(struck, index, bit, budget, args, golden)[0]
            return b""

        ended = run_in_child(work, 120.0)
        while len(hows) < len(todo) and outcomes[len(hows)]:
            hows.append(OUTCOMES[bytes([outcomes[len(hows)]])])
        if len(hows) < len(todo):
            hows.append(ended.how)
    silent = Counter(str(sites[index]) for (index, _), how in zip(todo, hows, strict=True) if how == "sdc")
    return Counter(hows), silent


def outcome(struck, index, bit, budget, args, golden):
    arguments = copied(args)
    try:
        result = struck.inject(index, -1, 1 << bit, budget, *arguments)
    except SystemError:
        return b"D"
    except Exception:
        return b"E"
    return b"M" if digest((result, arguments)) == golden else b"S"
