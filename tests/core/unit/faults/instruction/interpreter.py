"""An interpreter of LLVM IR text, slow and obvious, that shares no code with the injector: the oracle of exactness.

It knows scalars, branches and the store of a result; that is all that the small kernels need.
"""

import math
import re
import struct

import numpy as np

HANG = "hang"
_BITS = {"double": 64, "ptr": 64}
_NAME = r'%(?:"[^"]*"|[-\w$.]+)'
_FLAGS = re.compile(r"\b(nuw|nsw|exact|disjoint|nneg|samesign|tail|noundef) ")


def to_bits(number):
    return struct.unpack("<Q", struct.pack("<d", number))[0]


def to_double(bits):
    return struct.unpack("<d", struct.pack("<Q", bits & (2**64 - 1)))[0]


def same(a, b):
    """Bit for bit, but for the payload of NaN."""
    return to_bits(a) == to_bits(b) or (math.isnan(a) and math.isnan(b))


def width(kind):
    return _BITS.get(kind) or int(kind[1:])


def signed(value, bits):
    return value - (1 << bits) if value >> (bits - 1) else value


def constant(text, kind):
    if kind == "double":
        return struct.unpack(">d", bytes.fromhex(text[2:]))[0] if text.startswith("0x") else float(text)
    if text in ("true", "false"):
        return int(text == "true")
    return 0 if text == "null" else int(text) & ((1 << width(kind)) - 1)


ARITHMETIC = {
    "fadd": lambda x, y: float(np.add(x, y)),
    "fsub": lambda x, y: float(np.subtract(x, y)),
    "fmul": lambda x, y: float(np.multiply(x, y)),
    "fdiv": lambda x, y: float(np.divide(x, y)),
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "shl": lambda x, y: x << y,
    "lshr": lambda x, y: x >> y,
    "and": lambda x, y: x & y,
    "or": lambda x, y: x | y,
    "xor": lambda x, y: x ^ y,
}
_COMPARE = {
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "lt": lambda x, y: x < y,
    "gt": lambda x, y: x > y,
    "le": lambda x, y: x <= y,
    "ge": lambda x, y: x >= y,
}


class Interpreter:
    """Runs one function of a module."""

    def __init__(self, text, name):
        define = re.search(rf"^define [^\n]*@_ZN(?!7cpython)[^\n(]*{name}[^\n]*\n", text, re.MULTILINE)
        self.parameters = re.findall(rf"({_NAME})(?=[,)])", define[0])
        body = text[define.end() : text.index("\n}", define.end())]
        self.blocks, label = {}, None
        for line in body.split("\n"):
            line = re.sub(r"(, ![\w.]+ !\d+)+$", "", line.split(" ;")[0].rstrip())
            if re.fullmatch(r"[-\w$.]+:", line):
                label = "%" + line[:-1]
                self.blocks[label] = []
            elif line.strip() and not line.strip().startswith("#dbg"):
                self.blocks[label].append(self.compiled(_FLAGS.sub("", line.strip())))
        self.first = next(iter(self.blocks))

    def compiled(self, line):
        result = re.match(rf"({_NAME}) = (.*)", line)
        name, text = (result[1], result[2]) if result else (None, line)
        op = text.split()[0]
        reader = getattr(self, f"_{op}", None)
        kind, action = reader(text) if reader else self._binary(op, text)
        return op, name, kind, action

    @staticmethod
    def operand(text, kind):
        if text.startswith("%"):
            return lambda values: values[text]
        value = constant(text, kind)
        return lambda values: value

    def _binary(self, op, text):
        _, kind, left, right = re.fullmatch(r"(\w+) (\w+) ([^,]+), (.+)", text).groups()
        x, y, function = self.operand(left, kind), self.operand(right, kind), ARITHMETIC[op]
        mask = None if kind == "double" else (1 << width(kind)) - 1
        if mask is None:
            return kind, lambda v: function(x(v), y(v))
        return kind, lambda v: function(x(v), y(v)) & mask

    def _icmp(self, text):
        _, predicate, kind, left, right = re.fullmatch(r"(\w+) (\w+) (\w+) ([^,]+), (.+)", text).groups()
        x, y, compare, bits = self.operand(left, kind), self.operand(right, kind), _COMPARE[predicate[-2:]], width(kind)
        if predicate[0] == "s":
            return "i1", lambda v: int(compare(signed(x(v), bits), signed(y(v), bits)))
        return "i1", lambda v: int(compare(x(v), y(v)))

    def _fcmp(self, text):
        _, predicate, kind, left, right = re.fullmatch(r"(\w+) (\w+) (\w+) ([^,]+), (.+)", text).groups()
        x, y, compare = self.operand(left, kind), self.operand(right, kind), _COMPARE[predicate[1:]]
        unordered = predicate[0] == "u"

        def action(v):
            a, b = x(v), y(v)
            return int(unordered) if math.isnan(a) or math.isnan(b) else int(compare(a, b))

        return "i1", action

    def _select(self, text):
        c, kind, left, right = re.fullmatch(r"select i1 ([^,]+), (\w+) ([^,]+), \w+ (.+)", text).groups()
        condition, x, y = self.operand(c, "i1"), self.operand(left, kind), self.operand(right, kind)
        return kind, lambda v: x(v) if condition(v) else y(v)

    def _sitofp(self, text):
        kind, value = re.fullmatch(r"sitofp (\w+) (\S+) to double", text).groups()
        x = self.operand(value, kind)
        return "double", lambda v: float(signed(x(v), width(kind)))

    def _uitofp(self, text):
        kind, value = re.fullmatch(r"uitofp (\w+) (\S+) to double", text).groups()
        x = self.operand(value, kind)
        return "double", lambda v: float(x(v))

    def _zext(self, text):
        kind, value, target = re.fullmatch(r"zext (\w+) (\S+) to (\w+)", text).groups()
        return target, self.operand(value, kind)

    def _trunc(self, text):
        kind, value, target = re.fullmatch(r"trunc (\w+) (\S+) to (\w+)", text).groups()
        x, mask = self.operand(value, kind), (1 << width(target)) - 1
        return target, lambda v: x(v) & mask

    def _freeze(self, text):
        kind, value = re.fullmatch(r"freeze (\w+) (\S+)", text).groups()
        return kind, self.operand(value, kind)

    def _call(self, text):
        kind, name, rest = re.match(r"call (\w+) @(?:llvm\.)?(\w+)(?:\.\w+)?\((.*)\)", text).groups()
        read = [self.operand(part.split()[-1], kind) for part in rest.split(",")]
        bits = width(kind)
        function = {
            "smax": lambda x, y: max(x, y, key=lambda n: signed(n, bits)),
            "umax": max,
            "umin": min,
            "smin": lambda x, y: min(x, y, key=lambda n: signed(n, bits)),
            "sqrt": lambda x: float(np.sqrt(x)),
            "fabs": abs,
        }[name]
        return kind, lambda v: function(*(x(v) for x in read))

    def _phi(self, text):
        kind, rest = re.match(r"phi (\w+) (.*)", text).groups()
        pairs = {label: self.operand(value, kind) for value, label in re.findall(rf"\[ (\S+), ({_NAME}) \]", rest)}
        return kind, pairs

    def _store(self, text):
        kind, value, target = re.match(rf"store (\w+) ([^,]+), ptr ({_NAME})", text).groups()
        return target, self.operand(value, kind)

    def _br(self, text):
        return "", re.match(rf"br (?:i1 ([^,]+), )?label ({_NAME})(?:, label ({_NAME}))?$", text).groups()

    def _ret(self, text):
        return "", None

    def run(self, arguments, fault=None, budget=10**9, trace=None):
        """What the function stores into its first parameter, or HANG.

        Args:
            arguments: Of the kernel; parameters 0 and 1 are pointers for the result and the exception.
            fault: Dynamic index and bit, or None.
            budget: Values that may be written.
            trace: A list that takes opcode and type of every value that is written.
        """
        with np.errstate(all="ignore"):
            return self._run(arguments, fault, budget, [] if trace is None else trace)

    def _run(self, arguments, fault, budget, trace):
        values = dict(zip(self.parameters[2:], arguments, strict=True))
        label, before, index = self.first, None, 0
        memory = {}
        while True:
            lines = self.blocks[label]
            start, index = index, index + sum(name is not None for _, name, _, _ in lines)
            if index > budget and (fault is None or start > fault[0]):
                return HANG
            phis = {name: action[before](values) for op, name, _, action in lines if op == "phi"}
            following, at = None, start
            for op, name, kind, action in lines:
                if op == "ret":
                    return memory[self.parameters[0]]
                if op == "br":
                    condition, yes, no = action
                    following = yes if condition is None or self.operand(condition, "i1")(values) else no
                elif op == "store":
                    memory[kind] = action(values)
                else:
                    value = phis[name] if op == "phi" else action(values)
                    values[name] = flipped(value, kind, fault[1]) if fault and fault[0] == at else value
                    trace.append((op, kind))
                    at += 1
            label, before = following, label


def flipped(value, kind, bit):
    return to_double(to_bits(value) ^ (1 << bit)) if kind == "double" else value ^ (1 << bit)
