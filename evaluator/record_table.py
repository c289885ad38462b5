"""Turns decoded records into numpy tables, several times faster than numpy would.

MessagePack writes each record of the same float fields with the same number of bytes, so the encoding, done in C,
already is a structured array.
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


_ROW_2D = _row(amodal=4, modal=4)
_ROW_3D = _row(center=3, dimensions=3, rotation=4)


def tabulate_2d(records: Sequence[Box2d]) -> NDArray[Any] | None:
    """Make a table with the columns amodal and modal; None when a record lacks its modal box."""
    return _tabulate(records, _ROW_2D)


def tabulate_3d(records: Sequence[Box3d]) -> NDArray[Any]:
    """Make a table with the columns center, dimensions and rotation."""
    table = _tabulate(records, _ROW_3D)
    if table is None:
        raise AssertionError("msgspec no longer writes floats with nine bytes")
    return table


def _tabulate(records: Sequence[object], row: np.dtype[Any]) -> NDArray[Any] | None:
    """Read the encoding as a table, None when it has another size."""
    encoded = _ENCODER.encode(records)
    count = len(records)
    header = 1 if count < _SHORT_ARRAY else 3 if count < _MEDIUM_ARRAY else 5
    if len(encoded) != header + count * row.itemsize:
        return None
    return np.frombuffer(encoded, dtype=row, offset=header) if count else np.empty(0, dtype=row)


def floats(table: NDArray[Any], column: str) -> Float64Array:
    """Take one column as an array (N, width)."""
    return table[column]["value"].astype(np.float64)
