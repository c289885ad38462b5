"""One file for named arrays and a few facts about them: deterministic bytes, no pickle, no compression.

Layout: the magic line, the length of the header (8 bytes, little endian), the header (JSON with sorted keys:
`facts` and, for each array, name, dtype, shape), then the arrays one after another, C order, little endian,
each starting at a multiple of 8 bytes. Equal content gives equal bytes, so a digest names the content.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.errors import DataError

MAGIC = b"cs3d-arrays-1\n\0\0"
"""16 bytes, so that everything behind it stays aligned."""

_ALIGNMENT = 8
_KINDS = "biuf"
"""numpy kinds that may be stored: plain numbers only, nothing that could hold an object."""

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

AnyArray = NDArray[Any]


class ArrayFileError(DataError):
    """The bytes are no array file of this version; produce the file again."""

    code = "invalid_array_file"


class _Array(msgspec.Struct, frozen=True):
    name: str
    dtype: str
    shape: tuple[int, ...]


class _Header(msgspec.Struct, frozen=True):
    facts: dict[str, Any]
    arrays: tuple[_Array, ...]


def _padding(size: int) -> int:
    return -size % _ALIGNMENT


def pack(facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> bytes:
    """Write arrays and facts.

    Args:
        facts: Anything JSON can hold.
        arrays: Boolean, integer or float arrays of any shape, by name.

    Returns:
        The file's bytes; the same arguments always give the same bytes.
    """
    stored = {name: _little_endian(array) for name, array in arrays.items()}
    entries = tuple(_Array(name, array.dtype.str, array.shape) for name, array in stored.items())
    header = msgspec.json.encode(_Header(dict(facts), entries), order="sorted")
    header += b" " * _padding(len(header))
    parts = [MAGIC, len(header).to_bytes(8, "little"), header]
    for array in stored.values():
        raw = array.tobytes()
        parts += [raw, bytes(_padding(len(raw)))]
    return b"".join(parts)


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Read what `pack` wrote; the arrays are read-only views of `data`.

    Raises:
        ArrayFileError: The bytes are not such a file or are cut short.
    """
    try:
        return _unpack(data)
    except (ValueError, TypeError, msgspec.DecodeError) as error:
        raise ArrayFileError(f"Not a readable array file ({error}); produce it again.") from error


def pack_fields(record: "DataclassInstance") -> bytes:
    """Write a dataclass whose fields are arrays and tuples of names."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    return pack({name: values[name] for name in values.keys() - arrays.keys()}, arrays)


def unpack_fields(data: bytes, kind: "type[DataclassInstance]", *, what: str) -> dict[str, Any]:
    """Read what `pack_fields` wrote of a dataclass of this kind: the values by field.

    Args:
        data: The file's bytes.
        kind: The dataclass.
        what: What it is called in messages.

    Raises:
        ArrayFileError: The bytes are something else or are cut short.
    """
    facts, arrays = unpack(data)
    if facts.keys() | arrays.keys() != {field.name for field in fields(kind)}:
        raise ArrayFileError(f"The array file does not hold {what}; produce the file again.")
    return {**{name: tuple(value) for name, value in facts.items()}, **arrays}


def _unpack(data: bytes) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    if not data.startswith(MAGIC):
        raise ArrayFileError("Not an array file of this version; produce it again.")
    start = len(MAGIC) + 8
    end = start + int.from_bytes(data[len(MAGIC) : start], "little")
    header = msgspec.json.decode(data[start:end], type=_Header)
    arrays: dict[str, AnyArray] = {}
    for entry in header.arrays:
        arrays[entry.name], end = _read_array(data, entry, end)
    if end != len(data):
        raise ArrayFileError(f"The array file has {len(data)} bytes, its header says {end}; produce it again.")
    return header.facts, arrays


def _read_array(data: bytes, entry: _Array, start: int) -> tuple[AnyArray, int]:
    dtype = np.dtype(entry.dtype)
    if dtype.kind not in _KINDS or min(entry.shape, default=0) < 0:
        raise ArrayFileError(f"Array {entry.name!r} has a type that is never stored; produce the file again.")
    count = int(np.prod(entry.shape, dtype=np.int64))
    array = np.frombuffer(data, dtype=dtype, count=count, offset=start).reshape(entry.shape)
    size = count * dtype.itemsize
    return array, start + size + _padding(size)


def _little_endian(array: AnyArray) -> AnyArray:
    if array.dtype.kind not in _KINDS:
        raise TypeError(f"arrays of dtype {array.dtype} cannot be stored")
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)
