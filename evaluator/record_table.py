"""Turns decoded records into numpy tables, several times faster than numpy would.

MessagePack writes each record of the same float fields with the same number of bytes, so the encoding, done in C,
already is a structured array. Each file's records are encoded while they are still in the processor's cache, and
become a table together.
"""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.decoding import Box2d, Box3d
from evaluator.predictions import Float64Array

_ENCODER = msgspec.msgpack.Encoder()
_FLOAT = np.dtype([("marker", "u1"), ("value", ">f8")])
"""One byte, then eight of big-endian IEEE 754."""
_SHORT_ARRAY = 16
_MEDIUM_ARRAY = 1 << 16


def _row(**widths: int) -> np.dtype[Any]:
    """Describe a record of arrays: a one-byte map header; each key a byte and its letters; each array a byte before it."""
    fields: list[Any] = [("map", "V1")]
    for name, width in widths.items():
        fields += [(f"{name} key", f"V{1 + len(name) + 1}"), (name, _FLOAT, (width,))]
    return np.dtype(fields)


ROW_2D = _row(amodal=4, modal=4)
"""Columns amodal and modal of `Box2d` records that have both."""
ROW_3D = _row(center=3, dimensions=3, rotation=4)
"""Columns center, dimensions and rotation of `Box3d` records."""


def encode_rows(records: Sequence[Box2d] | Sequence[Box3d], row: np.dtype[Any]) -> bytes | None:
    """Encode records as rows of a table; None when some lack a field."""
    encoded = _ENCODER.encode(records)
    count = len(records)
    header = 1 if count < _SHORT_ARRAY else 3 if count < _MEDIUM_ARRAY else 5
    return encoded[header:] if len(encoded) == header + count * row.itemsize else None


def make_table(rows: Sequence[bytes], row: np.dtype[Any]) -> NDArray[Any]:
    """Join encoded rows to a table."""
    return np.frombuffer(b"".join(rows), dtype=row)


def floats(table: NDArray[Any], column: str) -> Float64Array:
    """Take one column as an array (N, width)."""
    return table[column]["value"].astype(np.float64)
