"""Messages that are records: numbers at fixed offsets."""

from collections.abc import Mapping

import numpy as np

from mavfi.errors import BadInputError, allowed
from mavfi.faults.message.definition import FORMATS, Leaf


class Record:
    """Layout of the messages of a topic, by the offset of each number; see `flight_logs.reader.Layout`.

    Args:
        kind: Name of the type.
        leaves: Place of each number, by its name.
    """

    def __init__(self, kind: str, leaves: Mapping[str, Leaf]) -> None:
        self.kind, self._leaves = kind, dict(leaves)

    @staticmethod
    def of(kind: str, dtype: np.dtype) -> "Record":
        """The layout of rows of a structured array."""
        fields = {} if dtype.fields is None else dtype.fields
        return Record(kind, {name: Leaf(entry[1], entry[0].name) for name, entry in fields.items()})

    def check(self, path: str) -> str:
        """Kind of a number, e.g. "float32", or a BadInputError."""
        if path not in self._leaves:
            raise BadInputError(f"field {path}: {self.kind} has no such number; allowed: {allowed(self._leaves, path)}")
        return self._leaves[path].kind

    def locate(self, data: bytes, path: str) -> Leaf:
        """Location of a number."""
        del data
        return self._leaves[path]

    def numbers(self, data: bytes, longest_list: int) -> list[str]:
        """Names of all numbers."""
        del data, longest_list
        return list(self._leaves)


def numeric(dtype: np.dtype) -> bool:
    """Whether a NumPy type is one of `FORMATS`."""
    return dtype.name in FORMATS
