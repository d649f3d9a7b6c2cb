"""What careless and hostile hands do to a file: a mutation of plain data, which every format has, and one of bytes.

Plain data may hold the words of `RAW`: what no writer of YAML or JSON writes takes their place in the text.
"""

import copy
import json
import re
import struct

import yaml

_DEEP = 100_000
RAW = {
    "ZZdeepZZ": "[" * _DEEP + "]" * _DEEP,
    "ZZmapsZZ": "{a: " * _DEEP + "1" + "}" * _DEEP,
    "ZZopenZZ": "[" * 9000,
    "ZZlaughsZZ": "[&a0 [lol, lol, lol], "
    + ", ".join(f"&a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12))
    + "]",
    "ZZmergesZZ": "{x: &m0 {k: 1}, "
    + ", ".join(f"y{n}: &m{n} {{<<: [{', '.join([f'*m{n - 1}'] * 9)}]}}" for n in range(1, 9))
    + "}",
    "ZZselfZZ": "&self [*self]",
    "ZZselfmapZZ": "&self {a: *self}",
    "ZZcodeZZ": "!!python/object/apply:os._exit [3]",
    "ZZtagZZ": "!unknown x",
    "ZZbinaryZZ": "!!binary aGVsbG8=",
    "ZZdateZZ": "2001-01-01",
    "ZZnodateZZ": "2001-99-99",
    "ZZnofloatZZ": "!!float x",
    "ZZnoboolZZ": "!!bool x",
    "ZZsetZZ": "!!set {a, b}",
    "ZZomapZZ": "!!omap [a: 1]",
    "ZZmergeZZ": "{<<: [{a: 1}, 3]}",
    "ZZnullkeyZZ": "{~: 1, true: 2, 1.5: 3, [1, 2]: 4}",
    "ZZmapkeyZZ": "{{a: 1}: 2}",
    "ZZtwiceZZ": "{a: 1, a: 2}",
    "ZZsixtyZZ": "190:20:30",
    "ZZdigitsZZ": "9" * 5000,
    "ZZhexZZ": "0x" + "f" * 10_000,
    "ZZhugeZZ": "1e999",
    "ZZlongZZ": "x" * 300_000,
}
RAW_JSON = {
    "ZZdeepZZ": RAW["ZZdeepZZ"],
    "ZZopenZZ": "[" * _DEEP,
    "ZZdigitsZZ": "9" * 5000,
    "ZZhugeZZ": "1e999",
    "ZZnanZZ": "NaN",
    "ZZtwiceZZ": '{"a": 1, "a": 2}',
    "ZZlongZZ": '"' + "x" * 300_000 + '"',
}
NUMBERS = (
    0, -1, 1, 2, 7, 255, 65_536, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64, 10**30, -(2**31),
    -(2**63), -(2**63) - 1, 0.0, -0.0, 0.5, -0.5, 1.5, 1e-320, 1e-30, 1e-9, 1e9, 1e18, 1e30, 1e300, -1e300,
    1.7976931348623157e308, float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
TEXTS = (
    "", " ", "x", "null", "nan", "inf", "-1", "1e5", "0x10", "true", "1 m", "12 kg", "\x00", "a\x00b", "\x1b[31mred",
    "\r\n", "two\nlines", "ünïcödé", "\u202e\u0000", "\ud7ff", "🚁", "../../etc/passwd", "/dev/zero", "/dev/stdin", ".",
    "/", "x.yaml", "x.bt", "%s%n", "{0}", "builtins:dict", "builtins:exit", "os:system", "none", "all", "x" * 5000,
)  # fmt: skip


def places(tree):
    """Every part of plain data, as its owner and its key there."""
    parts_of_tree, left = [], [tree]
    while left:
        owner = left.pop()
        keys = list(owner) if isinstance(owner, dict) else range(len(owner))
        for key in keys:
            parts_of_tree.append((owner, key))
            if isinstance(owner[key], (dict, list)):
                left.append(owner[key])
    return parts_of_tree


def nasty(draw, raw):
    """A value that nobody asked for."""
    plain = (None, True, False, [], {}, [None], [[]], {"": ""}, {"x": 1}, [0.0] * 4)
    return copy.deepcopy(draw.choice(draw.choice((NUMBERS, TEXTS, list(raw), plain))))


def changed(tree, draw, others, raw):
    """Plain data with one to three parts changed, none of them its outermost mapping or list."""
    tree = copy.deepcopy(tree)
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        parts_of_tree = places(tree)
        if not parts_of_tree:
            return tree
        _change(*draw.choice(parts_of_tree), draw, others, raw)
    return tree


def _change(owner, key, draw, others, raw):
    value, kind = owner[key], draw.randrange(6)
    if kind == 0:
        owner[key] = nasty(draw, raw)
    elif kind == 1:
        owner[key] = _bent(value, draw)
    elif kind == 2:
        del owner[key]
    elif kind == 3:
        other, key_there = draw.choice(places(draw.choice(others)))
        owner[key] = copy.deepcopy(other[key_there])
    elif isinstance(owner, list):
        owner.insert(draw.randrange(len(owner) + 1), copy.deepcopy(value))
    else:
        owner[draw.choice((*owner, *TEXTS, "nmae", "Mass", "mass ", 3, None, True, 1.5))] = owner.pop(key)


def _bent(value, draw):
    """The value, a little otherwise."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        factor = draw.choice((-1, 0, 1e-9, 1e-3, 0.5, 2, 10, 1e3, 1e6, 1e12))
        return draw.choice((value * factor, value + 1, str(value), f"{value} m", [value], int(factor)))
    if isinstance(value, str):
        return draw.choice((value[:-1], value.upper(), value + draw.choice(TEXTS), 3))
    if isinstance(value, bytes):
        return draw.choice((value[:-1], value.upper(), value[::-1], value * 2))
    if isinstance(value, list):
        return draw.choice((value[1:], value * 2, value * 100, value[::-1], dict(enumerate(value))))
    return draw.choice(([value], str(value), {"x": value}, [value] * 300))


def words_of(data):
    """Words and numbers of a text or of bytes, and what is between them."""
    return re.split(rb"([\w.+-]+)", data)


def joined(pieces):
    """The text of words, some of which have become something else."""
    return b"".join(word if isinstance(word, bytes) else str(word).encode() for word in pieces)


def to_yaml(tree):
    """YAML text."""
    text = yaml.dump(tree, Dumper=yaml.CSafeDumper, allow_unicode=True)
    return _with_raw(text, RAW).encode("utf-8", "surrogatepass")


def to_json(tree):
    """JSON text."""
    return _with_raw(json.dumps(tree), {f'"{word}"': raw for word, raw in RAW_JSON.items()}).encode()


def _with_raw(text, raw):
    for word, instead in raw.items():
        text = text.replace(word, instead)
    return text


def mangled(data, draw):
    """Bytes with one to four places changed: bits flipped, parts cut, repeated, put in or overwritten."""
    data = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(data) + 1)
        end = min(len(data), at + draw.choice((1, 2, 8, 64, 1024)))
        kind = draw.randrange(6)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << draw.randrange(8)
        elif kind == 1:
            del data[at:end]
        elif kind == 2:
            del data[at:]
        elif kind == 3:
            data[at:at] = draw.choice(
                (b"\x00", b"\xff" * 8, b"\n", b"  ", b"\t", b"&a ", b"*a ", b"{", b"]", b": ", b"%")
            )
        elif kind == 4:
            data[at:at] = data[at:end] * draw.choice((1, 2, 50))
        else:
            word = draw.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**16, 1000))
            data[at : at + 4] = struct.pack("<I", word)
    return bytes(data)
