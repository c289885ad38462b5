"""Turns decoded records into numpy tables, several times faster than numpy would.

MessagePack writes each record of the same float fields with the same number of bytes, so the encoding, done in C,
already is a structured array.
"""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.decoding import Box, LabelLetter
from evaluator.predictions import Float64Array, IndexArray

_ENCODER = msgspec.msgpack.Encoder()
_FLOAT = np.dtype([("marker", "u1"), ("value", ">f8")])
"""One byte, then eight of big-endian IEEE 754."""
_LETTER = np.dtype([("marker", "u1"), ("value", "u1")])
"""A text of one ASCII character."""
_SHORT_ARRAY = 16
_MEDIUM_ARRAY = 1 << 16
_LONGEST_HEADER = 5


def _key(name: str, marker_bytes: int = 0) -> tuple[str, str]:
    """Describe a key: a byte and its letters, and the marker of the map or array that follows it."""
    return f"{name} key", f"V{1 + len(name) + marker_bytes}"


def _array(name: str, width: int) -> list[Any]:
    """Describe a key with an array of floats."""
    return [_key(name, 1), (name, _FLOAT, (width,))]


_ROW = np.dtype(
    [
        *[("map", "V1"), _key("label"), ("label", _LETTER), _key("score"), ("score", _FLOAT)],
        *[_key("2d", 1), *_array("amodal", 4), *_array("modal", 4)],
        *[_key("3d", 1), *_array("center", 3), *_array("dimensions", 3), *_array("rotation", 4)],
    ]
)
"""A `Box` that has a modal box."""


def append_rows(rows: bytearray, records: Sequence[Box[LabelLetter]]) -> bool:
    """Append records to the rows of a table; if some lack a field, say so and do not.

    MessagePack puts a header before the records. It is written over the end of what there is, which is then put back.
    """
    count, end = len(records), len(rows)
    header = 1 if count < _SHORT_ARRAY else 3 if count < _MEDIUM_ARRAY else 5
    last = rows[end - header :]
    _ENCODER.encode_into(records, rows, end - header)
    rows[end - header : end] = last
    if len(rows) == end + count * _ROW.itemsize:
        return True
    del rows[end:]
    return False


def new_rows() -> bytearray:
    """Return no rows, with room for a header before the first."""
    return bytearray(_LONGEST_HEADER)


def make_table(rows: bytearray) -> NDArray[Any]:
    """Return rows as a table."""
    return np.frombuffer(rows, dtype=_ROW, offset=_LONGEST_HEADER)


def letter_codes(table: NDArray[Any]) -> IndexArray:
    """Take the labels, (N,) int32 code points."""
    return table["label"]["value"].astype(np.int32)


def floats(table: NDArray[Any], column: str) -> Float64Array:
    """Take one column of numbers as an array (N,) or (N, width)."""
    return table[column]["value"].astype(np.float64)
