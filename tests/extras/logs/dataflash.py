"""Writes a log of ArduPilot (DataFlash), from its description in ArduPilot's developer documentation."""

import struct

_HEAD = b"\xa3\x95"
_FMT = 0x80
_STRUCT = {"Q": "Q", "f": "f", "B": "B", "c": "h", "L": "i", "n": "4s", "N": "16s", "Z": "64s", "a": "64s", "b": "b"}
FORMATS = {
    "UNIT": (0x81, "QbZ", "TimeUS,Id,Label", ""),
    "FMTU": (0x82, "QBNN", "TimeUS,FmtType,UnitIds,MultIds", ""),
    "ATT": (0x83, "Qccc", "TimeUS,Roll,Pitch,Yaw", "sddh"),
    "IMU": (0x84, "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ", "s#EEE"),
}
"""Type, format and columns of each message, and the units of its columns."""

UNITS = (("s", "s"), ("d", "deg"), ("h", "degheading"), ("E", "rad/s"))


def record(name, *values):
    number, form, _, _ = FORMATS[name]
    return _HEAD + bytes([number]) + struct.pack("<" + "".join(_STRUCT[c] for c in form), *values)


def definitions():
    """What a log starts with: formats and units."""
    records = []
    formats = {"FMT": (_FMT, "BBnNZ", "Type,Length,Name,Format,Columns", ""), **FORMATS}
    for name, (number, form, columns, _) in formats.items():
        size = 3 + struct.calcsize("<" + "".join(_STRUCT.get(c, "B") for c in form))
        body = struct.pack("<BB4s16s64s", number, size, name.encode(), form.encode(), columns.encode())
        records.append(_HEAD + bytes([_FMT]) + body)
    for letter, label in UNITS:
        records.append(record("UNIT", 0, ord(letter), label.encode()))
    for number, _, _, units in FORMATS.values():
        if units:
            records.append(record("FMTU", 0, number, units.encode(), b"-" * len(units)))
    return b"".join(records)


def text_definitions():
    """The same as text, line by line."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    lines += [f"FMT, {number}, 1, {name}, {form}, {columns}" for name, (number, form, columns, _) in FORMATS.items()]
    lines += [f"UNIT, 0, {ord(letter)}, {label}" for letter, label in UNITS]
    lines += [f"FMTU, 0, {number}, {units}, {'-' * len(units)}" for number, _, _, units in FORMATS.values() if units]
    return lines
