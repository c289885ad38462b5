"""Decodes clean prediction files fast: JSON to typed records to arrays, without work in Python for each number.

It never explains: whatever is not clean here is looked at again, slowly, by `explanation.py`.
"""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from functools import lru_cache
from itertools import chain
from typing import Any, Generic, Self, TypeVar

import msgspec
import numpy as np
from msgspec import UNSET, Struct, UnsetType, field

Label = TypeVar("Label", bound=str)
Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class Box2d(Struct, gc=False):
    """The `2d` entry of a box: x, y of the upper left corner, width, height, in pixels."""

    amodal: Quadruple
    modal: Quadruple | UnsetType = UNSET


class Box3d(Struct, gc=False):
    """The `3d` entry of a box: metres in the vehicle frame, and a quaternion w, x, y, z."""

    center: Triple
    dimensions: Triple
    rotation: Quadruple


class Box(Struct, Generic[Label], gc=False):
    """One predicted box as the file has it."""

    label: Label
    score: float
    box_2d: Box2d = field(name="2d")
    box_3d: Box3d = field(name="3d")


class Document(Struct, Generic[Label], gc=False):
    """One prediction file."""

    objects: list[Box[Label]]


class LabelLetter(StrEnum):
    """A label: its value is what files call it, as a text it is one letter, which is what msgspec writes of it.

    So records need no work in Python before they become the rows of a table. `BoxDecoder` makes the members, of which
    the last stands for all unknown labels.
    """

    def __new__(cls, label: str, letter: str) -> Self:
        """Make the letter that a label is read as."""
        member = str.__new__(cls, letter)
        member._value_ = label
        return member

    @classmethod
    def _missing_(cls, value: object) -> Self:
        """Take a label that no member has."""
        del value
        return next(reversed(cls))


_UNTYPED = msgspec.json.Decoder()
_KEYS_PER_BOX = 8
"""2d, 3d, label, score, amodal, center, dimensions, rotation; modal is optional."""
_ARRAYS = {"2d": ("amodal", "modal"), "3d": ("center", "dimensions", "rotation")}
"""The keys whose values are arrays of numbers, which typed decoding has made sure of."""
MOST_LABELS = 127
"""Each has an ASCII letter, and so have all unknown ones together."""
_LARGEST_BYTE = 255
_ROW_BYTES = 1024
"""Added up at once; a multiple of eight."""
_CITYPERSONS_KEYS = {"bbox", "bboxVis"}


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Keep the cyclic collector from walking millions of fresh records that cannot form cycles."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class BoxDecoder:
    """Decodes files by type."""

    def __init__(self, known_labels: Sequence[str]) -> None:
        """Number the labels.

        Args:
            known_labels: 1 to `MOST_LABELS`, each once.
        """
        letters = {label: chr(number) for number, label in enumerate(known_labels) if _is_unicode(label)}
        letters[max(letters, key=len, default="") + "?"] = chr(len(known_labels))
        members = {f"label_{number}": pair for number, pair in enumerate(letters.items())}
        labels: type[LabelLetter] = LabelLetter("Label", members)  # type: ignore[assignment,arg-type]
        self._decoder: msgspec.json.Decoder[Document[LabelLetter]] = msgspec.json.Decoder(Document[labels])  # type: ignore[valid-type]

    def decode(self, data: bytes) -> list[Box[LabelLetter]] | None:
        """Decode a file, or give None when that fails. Extra and repeated keys pass; see `keys_are_expected`.

        Returns:
            The boxes; their labels are letters: chr(0) for the first known label, the one after the last for all others.
        """
        try:
            return self._decoder.decode(data).objects
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None


def _is_unicode(label: str) -> bool:
    """Tell whether a file can have this label; half a surrogate pair, as from a command line that is no UTF-8, cannot be."""
    return label == label.encode(errors="ignore").decode()


@lru_cache(maxsize=16)
def box_decoder(known_labels: tuple[str, ...]) -> BoxDecoder:
    """Return the decoder for these labels; making one takes as long as decoding several files."""
    return BoxDecoder(known_labels)


def count_colons(files: Sequence[bytes]) -> int:
    """Count the colons of some files, several times as fast as `bytes.count`.

    numpy compares dozens of bytes at once. What that gives, a byte of 0 or 1 for each, is added up eight bytes at a
    time, as one number, in which no byte overflows.
    """
    data = np.frombuffer(b"".join(files), dtype=np.uint8)
    count = 0
    for start in range(0, len(data), _LARGEST_BYTE * _ROW_BYTES):
        is_colon = data[start : start + _LARGEST_BYTE * _ROW_BYTES] == ord(":")
        rows_end = len(is_colon) // _ROW_BYTES * _ROW_BYTES
        rows = is_colon[:rows_end].view(np.uint64).reshape(-1, _ROW_BYTES // 8)
        count += int(rows.sum(axis=0).view(np.uint8).sum()) + int(np.count_nonzero(is_colon[rows_end:]))
    return count


def keys_are_expected(*, colons: int, files: int, boxes: int, modal: int) -> bool:
    """Prove for decoded files that every expected key is there exactly once and no other.

    Decoding found each required key at least once, and each takes a colon. So with as many colons in all the files
    as expected, no file has room for a second one, nor for anything else.

    Args:
        colons: how many colons the files have together.
        files: how many files there are, all taken by `decode`.
        boxes: how many boxes they hold.
        modal: how many of these have a modal box.
    """
    return colons == files + _KEYS_PER_BOX * boxes + modal


def extra_keys_are_clean(data: bytes, depth_limit: int) -> bool:
    """Prove for a file with keys of its own, taken by `decode`, that none stands twice and the rest is sound JSON, too.

    The typed decoder skips what it does not know; here everything is decoded, and there must be as many colons as
    keys that survived. A colon inside a string only leads to the slow path.
    """
    try:
        return _all_keys_survive(data, depth_limit)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return False


def _all_keys_survive(data: bytes, depth_limit: int) -> bool:
    """Compare the keys of the decoded document with the colons of its text."""
    document = _UNTYPED.decode(data)
    boxes = document.pop("objects")
    keys, parts = 1, []
    for name, arrays in _ARRAYS.items():
        part = [box.pop(name) for box in boxes]
        keys += len(part) + sum(values.pop(array, None) is not None for array in arrays for values in part)
        parts += part
    # What is left was not looked at by type. Boxes are inside a document and an array, their parts one step deeper.
    rest = [_count_keys(level, depth_limit - outer) for level, outer in (([document], 0), (boxes, 2), (parts, 3))]
    return None not in rest and keys + sum(filter(None, rest)) == count_colons([data])


def _count_keys(level: list[Any], depth_limit: int) -> int | None:
    """Count the keys of all objects inside each other; None when they are too deep or need a closer look."""
    keys = 0
    for _ in range(depth_limit):
        objects = [value for value in level if type(value) is dict]
        keys += sum(map(len, objects))
        if any(map(_CITYPERSONS_KEYS.issubset, objects)):
            return None
        arrays = [value for value in level if type(value) is list]
        level = [
            value
            for value in chain(chain.from_iterable(map(dict.values, objects)), chain.from_iterable(arrays))
            if type(value) is dict or type(value) is list
        ]
        if not level:
            return keys
    return None
