"""Digest of a module's fault space: the same in every process and folder, wherever its source is.

The parser has removed line tables and debug metadata, and renamed local values.  Names of compiled functions contain
their module, a number by process and the types of their arguments; here they are numbers in the order of their use, for
the functions themselves are in the digest.
"""

import hashlib
import re

from mavfi.ir.module import Module

DIGEST_VERSION = "2"
"""Version of the digest; a campaign that was begun with another one cannot be resumed."""
_GLOBAL = re.compile(r'@(?:"[^"]*"|[-\w$.]+)')
_NAMED_BY_SOURCE = re.compile(r'@"?(_ZN|\.const\.|\.bytes\.)')
"""Beginnings of the names of compiled functions, and of constants that are named by hashes of texts or of exceptions
with the path and line of their source."""
_PICKLED_SIZE = re.compile(r"(store ptr @\.const\.pickledata\.\S+ ,?[^\n]*\n[^\n]*\n\s*store i32 )\d+")
"""Stored length of a pickled exception: it grows with the path."""


def bodies_of(module: Module) -> str:
    """Text of the functions in the fault space."""
    return "\n".join(function.text() for function in module.functions)


def digest_of(module: Module) -> str:
    """SHA-256 of the functions in the fault space."""
    return digest_of_text(bodies_of(module))


def digest_of_text(bodies: str) -> str:
    """SHA-256 of IR, without what differs between processes and what names the source."""
    numbers: dict[str, int] = {}

    def neutral(match: re.Match[str]) -> str:
        name = match[0]
        if not _NAMED_BY_SOURCE.match(name):
            return name
        return f"@global.{numbers.setdefault(name, len(numbers))}"

    text = _GLOBAL.sub(neutral, _PICKLED_SIZE.sub(r"\1*", bodies))
    return hashlib.sha256(text.encode()).hexdigest()
