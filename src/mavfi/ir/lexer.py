"""Tokens of LLVM IR, and a cursor over the tokens of one line."""

import re

from mavfi.ir.refusal import RefusedError

_TOKEN = re.compile(
    r"""\s*(?:
      (?P<local>%(?:"[^"]*"|[-\w$.]+)) | (?P<global>@(?:"[^"]*"|[-\w$.]+)) | (?P<group>\#\d+) | (?P<metadata>![\w.]*)
    | (?P<text>c?"[^"]*") | (?P<number>-?(?:0x[HKLMR]?[0-9A-Fa-f]+|\d+\.\d*(?:e[-+]?\d+)?|\d+)(?![\w.]))
    | (?P<word>[A-Za-z_][\w.]*) | (?P<dots>\.\.\.) | (?P<mark>[=,(){}<>\[\]*|]) | (?P<comment>;.*)
    )""",
    re.VERBOSE,
)
_NAME = re.compile(r'[%@](?:"[^"]*"|[-\w$.]+)')
LABEL = re.compile(r'("[^"]*"|[-\w$.]+):')
OPEN = {"(": ")", "{": "}", "[": "]", "<": ">"}
PLAIN_VALUES = ("true", "false", "null", "undef", "poison", "zeroinitializer", "none")
CONSTANT_EXPRESSIONS = ("getelementptr", "inttoptr", "ptrtoint", "bitcast", "add", "sub")
_SCALAR = re.compile(r"i\d+|half|bfloat|float|double|ptr|void")


def tokens_of(line: str, kernel: str) -> list[str]:
    """Tokens of a line without its comment; an unknown token is a RefusedError."""
    found, at, end = [], 0, len(line.rstrip())
    while at < end:
        match = _TOKEN.match(line, at)
        if match is None:
            raise RefusedError(kernel, f"text {line[at : at + 40].strip()!r} in {line.strip()[:80]!r}")
        if match.lastgroup != "comment":
            found.append(match[0].strip())
        at = match.end()
    return found


class Cursor:
    """Reads the tokens of one line from left to right; an unexpected token is a RefusedError."""

    def __init__(self, tokens: list[str], kernel: str) -> None:
        self.tokens = tokens
        self.kernel = kernel
        self.at = 0

    @property
    def next(self) -> str:
        """The next token; "" at the end."""
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def take(self) -> str:
        """Consume and return the next token."""
        token = self.next
        if not token:
            raise self.refused()
        self.at += 1
        return token

    def expect(self, *allowed: str) -> str:
        """Consume a token that must be one of these."""
        if self.next not in allowed:
            raise self.refused()
        return self.take()

    def accept(self, *allowed: str) -> bool:
        """Consume a token if it is one of these."""
        found = self.next in allowed and bool(self.next)
        self.at += found
        return found

    def refused(self, why: str = "") -> RefusedError:
        """The error that names the unknown construct."""
        line = " ".join(self.tokens)
        return RefusedError(self.kernel, why or f"{self.next or 'end of line'!r} in {line[:120]!r}")

    def finish(self) -> None:
        """Check that no token is left."""
        if self.next:
            raise self.refused()

    def balanced(self) -> list[str]:
        """Consume an opening bracket up to the matching closing one."""
        found, depth = [], 0
        while True:
            token = self.take()
            found.append(token)
            depth += (token in OPEN) - (token in OPEN.values())
            if depth == 0:
                return found

    def number(self) -> str:
        """Consume an unsigned number."""
        if not self.next.isdigit():
            raise self.refused()
        return self.take()

    def local(self) -> str:
        """Consume a local name."""
        if not self.next.startswith("%"):
            raise self.refused()
        return self.take()

    def kind(self) -> str:
        """Consume a type; returns its normalized spelling."""
        token = self.take()
        if token == "{":
            fields = [self.kind()]
            while self.accept(","):
                fields.append(self.kind())
            self.expect("}")
            return f"{{ {', '.join(fields)} }}"
        if token in ("<", "["):
            count = self.number()
            self.expect("x")
            element = self.kind()
            self.expect(OPEN[token])
            return f"{token}{count} x {element}{OPEN[token]}"
        if not _SCALAR.fullmatch(token):
            self.at -= 1
            raise self.refused()
        return token

    def value(self) -> str:
        """Consume a value: a local or global name, or a constant."""
        token = self.next
        if _NAME.fullmatch(token) or token in PLAIN_VALUES or token[:1].isdigit() or token[:1] == "-":
            return self.take()
        if token == "splat":
            return self._constant([self.take(), *self.balanced()])
        if token in OPEN and token != "(":
            return self._constant(self.balanced())
        if token in CONSTANT_EXPRESSIONS:
            words = [self.take()]
            while self.next in ("inbounds", "nuw", "nsw", "nusw"):
                self.take()
            return self._constant([*words, *self.balanced()])
        raise self.refused()

    def _constant(self, tokens: list[str]) -> str:
        if any(token[0] == "%" for token in tokens):
            raise self.refused()
        return " ".join(tokens)
