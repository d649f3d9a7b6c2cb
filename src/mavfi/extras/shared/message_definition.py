"""Messages of any type in the serialization of ROS 1, that of bags, without generated classes.

Messages of ROS 2 are converted to it.

A serialized message is the sequence of its fields, little-endian, packed; strings and lists of variable length start
with a uint32 (http://wiki.ros.org/msg).  So a field is located by traversing all previous fields.
"""

import re
import struct
from dataclasses import dataclass
from functools import cache

from mavfi.errors import BadInputError, MavfiError, allowed, not_known

FORMATS = {
    "bool": "B",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Numeric types, with their `struct` codes."""
_PAIRS = {"time": (("secs", "uint32"), ("nsecs", "uint32")), "duration": (("secs", "int32"), ("nsecs", "int32"))}
"""ROS 1's types of instants and durations: their two numbers."""
_STRING = "string"
"""The type of text, whose length is in the message."""
VARIABLE = -1
"""Length of a list that is in the message."""
_MEMBER = re.compile(r"([\w/]+)(\[(\d*)\])?\s+(\w+)\s*$")
"""A line of a definition: type, length of a list, name."""
_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])?)(?:\.|$)")
"""A part of a field's path: name and index."""
_COUNT = struct.Struct("<I")
"""Length of a list or text in a message."""


class AbsentError(MavfiError):
    """The element is absent in this message: its list is shorter."""


@dataclass(frozen=True, slots=True)
class Member:
    """A member of a message type; its kind is a numeric type, "string", or a message type."""

    name: str
    kind: str
    length: int | None = None
    """None = not a list; `VARIABLE` = a list whose length is in the message."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """A number in a message: its offset (bytes) and type."""

    offset: int
    kind: str

    @property
    def bits(self) -> int:
        """Size of the number (bits)."""
        return 8 * struct.calcsize(FORMATS[self.kind])

    def value(self, data: bytes | bytearray) -> int | float:
        """The number in a serialized message."""
        number: int | float = struct.unpack_from("<" + FORMATS[self.kind], data, self.offset)[0]
        return number


class Definition:
    """A message type, e.g. "sensor_msgs/JointState", with all its component types.

    Parsed from a full definition, as in a connection header or a bag; a missing type is a BadInputError.
    """

    def __init__(self, kind: str, text: str) -> None:
        """Parse.

        Args:
            kind: Name of the type.
            text: Its full definition: its own members, then those of each component type behind a line of "=".
        """
        self.kind = kind
        self.types: dict[str, tuple[Member, ...]] = {
            name: tuple(Member(part, pair_kind) for part, pair_kind in parts) for name, parts in _PAIRS.items()
        }
        first, *others = re.split(r"^={10,}\s*$", text, flags=re.MULTILINE)
        self.types[kind] = self._members(kind, first)
        for other in others:
            head, _, body = other.strip().partition("\n")
            name = head.removeprefix("MSG:").strip()
            self.types[name] = self._members(name, body)
        # A definition that lacks a type, or contains itself, could not be traversed.
        for members in self.types.values():
            for member in members:
                if member.kind not in FORMATS and member.kind != _STRING and member.kind not in self.types:
                    raise BadInputError(f"type {kind}: its definition lacks {member.kind}")
        self._check_finite(kind, [], set())
        self._sizes: dict[str, int | None] = {name: struct.calcsize(form) for name, form in FORMATS.items()}
        self._sizes[_STRING] = None

    def _check_finite(self, kind: str, outer_kinds: list[str], checked: set[str]) -> None:
        """Refuse a type that contains itself."""
        if kind in outer_kinds:
            raise BadInputError(f"type {self.kind}: its definition has a {kind} within a {kind}")
        for member in self.types[kind]:
            if member.kind in self.types and member.kind not in checked:
                self._check_finite(member.kind, [*outer_kinds, kind], checked)
        checked.add(kind)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Definition) and self.types == other.types

    def __hash__(self) -> int:
        return hash(self.kind)

    @staticmethod
    def _members(owner: str, text: str) -> tuple[Member, ...]:
        """The members in the definition of a type, with full names of their types."""
        package = owner.partition("/")[0]
        members = []
        for line in text.splitlines():
            match = _MEMBER.match(line.partition("#")[0].strip())
            if match is None:  # a comment, or a constant, which is not serialized
                continue
            kind, brackets, number, name = match.groups()
            length = None
            if brackets and number:
                length = int(number)
            elif brackets:
                length = VARIABLE
            if kind == "Header":
                kind = "std_msgs/Header"
            elif "/" not in kind and kind not in FORMATS and kind != _STRING and kind not in _PAIRS:
                kind = f"{package}/{kind}"
            members.append(Member(name, kind, length))
        return tuple(members)

    # ---- paths ------------------------------------------------------------------------------------------------------
    def check(self, path: str) -> str:
        """Kind of the number at a path like `transforms[0].transform.rotation.z`, or a BadInputError."""
        kind = self.kind
        for name, index in steps(path):
            member = self._member(kind, name, path)
            if index is None and member.length is not None:
                raise BadInputError(f"field {path}: {name} of {kind} is a list; allowed: {name}[0]")
            if index is not None and member.length is None:
                raise BadInputError(f"field {path}: {name} of {kind} is no list; allowed: {name}")
            if index is not None and member.length is not None and 0 <= member.length <= index:
                raise BadInputError(
                    f"field {path}: {name} has {member.length} elements; allowed: [0] to [{member.length - 1}]"
                )
            kind = member.kind
        if kind == _STRING:
            raise BadInputError(f"field {path}: is text; allowed: a number")
        if kind not in FORMATS:
            paths = [f"{path}.{member.name}" for member in self.types[kind]]
            raise BadInputError(f"field {path}: is a {kind}, no number; allowed: {allowed(paths)}")
        return kind

    def _member(self, kind: str, name: str, path: str) -> Member:
        """A member of a type, or a BadInputError."""
        for member in self.types.get(kind, ()):
            if member.name == name:
                return member
        if kind not in self.types:
            raise BadInputError(f"field {path}: a {kind} has no member {name!r}")
        names = []
        for member in self.types[kind]:
            if member.length is None:
                names.append(member.name)
            else:
                names.append(f"{member.name}[0]")
        raise BadInputError(f"field {path}: member of {kind} {not_known(name, names)}")

    def locate(self, data: bytes, path: str) -> Leaf:
        """Location of the number at a path in a serialized message.

        Raises:
            BadInputError: The type has no such member.
            AbsentError: A list of this message is too short.
            MavfiError: The message is not of this type.
        """
        offset = 0
        kind = self.kind
        try:
            for name, index in steps(path):
                # Skip the members before this one.
                for member in self.types.get(kind, ()):
                    if member.name == name:
                        break
                    offset = self._skip(member, data, offset)
                else:
                    member = self._member(kind, name, path)  # raises
                kind = member.kind
                if index is not None:
                    offset = self._element(member, data, offset, index, path)
            leaf = Leaf(offset, kind)
            leaf.value(data)
        except struct.error:
            raise self._too_short(data) from None
        return leaf

    def _too_short(self, data: bytes) -> MavfiError:
        return MavfiError(f"a message of {len(data)} bytes is not a {self.kind}: it is too short")

    def _element(self, member: Member, data: bytes, offset: int, index: int, path: str) -> int:
        """Offset of an element of a list."""
        count, offset = self._count(member, data, offset)
        if index >= count:
            raise AbsentError(f"field {path}: {member.name} has {count} elements in this message")
        single = Member(member.name, member.kind)
        size = self._size(member.kind)
        if size is not None:
            return offset + index * size
        for _ in range(index):
            offset = self._skip(single, data, offset)
        return offset

    @staticmethod
    def _count(member: Member, data: bytes, offset: int) -> tuple[int, int]:
        """Number of elements, 1 for a member that is not a list, and offset of the first."""
        if member.length is None:
            return 1, offset
        if member.length == VARIABLE:
            return _COUNT.unpack_from(data, offset)[0], offset + _COUNT.size
        return member.length, offset

    def _skip(self, member: Member, data: bytes, offset: int) -> int:
        """One past the last byte of a member."""
        count, offset = self._count(member, data, offset)
        size = self._size(member.kind)
        if size is not None:
            return offset + count * size
        for _ in range(count):
            if member.kind == _STRING:
                offset += _COUNT.size + _COUNT.unpack_from(data, offset)[0]
            else:
                for inner in self.types[member.kind]:
                    offset = self._skip(inner, data, offset)
        return offset

    def _size(self, kind: str) -> int | None:
        """Size of a fixed-size type (bytes), else None."""
        if kind not in self._sizes:
            self._sizes[kind] = self._sum_of_sizes(self.types[kind])
        return self._sizes[kind]

    def _sum_of_sizes(self, members: tuple[Member, ...]) -> int | None:
        """Size of members together (bytes); None if that of one of them is not fixed."""
        total = 0
        for member in members:
            size = self._size(member.kind)
            if size is None or member.length == VARIABLE:
                return None
            if member.length is None:
                total += size
            else:
                total += size * member.length
        return total

    # ---- whole messages ---------------------------------------------------------------------------------------------
    def numbers(self, data: bytes, longest_list: int) -> list[str]:
        """Paths of the numbers of a message, excluding headers and lists longer than `longest_list`.

        Raises:
            MavfiError: The message is not of this type.
        """
        try:
            return self._walk(Member("", self.kind), data, 0, "", longest_list)[0]
        except struct.error:
            raise self._too_short(data) from None

    def _walk(self, member: Member, data: bytes, offset: int, path: str, longest: int) -> tuple[list[str], int]:
        """Paths of the numbers within a member, and its end offset."""
        if member.kind in (_STRING, "std_msgs/Header"):
            return [], self._skip(member, data, offset)
        if member.length is None and member.kind in FORMATS:
            return [path], self._skip(member, data, offset)
        # Its parts with their paths: the members of a type, or the elements of a list.
        if member.length is None:
            parts = [(part, f"{path}.{part.name}".lstrip(".")) for part in self.types[member.kind]]
        else:
            count, start = self._count(member, data, offset)
            if count > longest:
                return [], self._skip(member, data, offset)
            parts = [(Member("", member.kind), f"{path}[{index}]") for index in range(count)]
            offset = start
        numbers = []
        for part, part_path in parts:
            inner_numbers, offset = self._walk(part, data, offset, part_path, longest)
            numbers += inner_numbers
        return numbers, offset


@cache
def steps(path: str) -> tuple[tuple[str, int | None], ...]:
    """The names and indices of a path; an invalid path is a BadInputError."""
    pairs: list[tuple[str, int | None]] = []
    position = 0
    while position < len(path):
        match = _STEP.match(path, position)
        if match is None:
            break
        name, brackets = match.groups()
        if brackets:
            pairs.append((name, int(brackets[1:-1])))
        else:
            pairs.append((name, None))
        position = match.end()
    if not pairs or position < len(path) or path.endswith("."):
        raise BadInputError(
            f"field {path!r}: allowed: names with dots and indices, like pose.position.x or position[0]"
        )
    return tuple(pairs)


def flip_bit(data: bytes, leaf: Leaf, bit: int) -> bytes:
    """The message with one bit of a number flipped; bit 0 is the least significant."""
    changed = bytearray(data)
    changed[leaf.offset + bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)
