"""Explains what is wrong with a prediction file: a slow walk over the whole document that locates every problem.

Runs only on files that the fast path (`decoding.py`) did not find clean. Linear in the file's size.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Set as AbstractSet
from typing import Any, TypeGuard

import msgspec
import numpy as np

from evaluator.codes import Code
from evaluator.decoding import Document
from evaluator.findings import Findings, quote
from evaluator.limits import Limits
from evaluator.value_ranges import (
    BOX_LIMIT_PX,
    CENTER_LIMIT_M,
    DIMENSION_RANGE_M,
    ROTATION_NORM_RANGE,
    box_is_near,
    center_is_valid,
    dimension_is_valid,
    rotation_is_normalised,
    score_is_valid,
)

_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
"""A JSON string, closed or not; possessive, so that no input makes it go back."""
_LONGEST_INTEGER = 20
"""Digits and sign; every integer up to 2**63 fits."""


class _Pairs(list[tuple[str, Any]]):
    """A JSON object with all its keys, repeated ones too."""


class _Number(str):
    """A number that no value may be, as the file writes it."""

    __slots__ = ()


class _NotFinite(_Number):
    """NaN, an infinity, or a number too large for a float."""

    __slots__ = ()


class _LongInteger(_Number):
    """An integer of too many digits."""

    __slots__ = ()


def _read_float(text: str) -> float | _NotFinite:
    """Read a number with a fraction or exponent."""
    value = float(text)
    return value if math.isfinite(value) else _NotFinite(text)


def _read_integer(text: str) -> int | _LongInteger:
    """Read an integer; a long one stays text, since converting it would take quadratic time."""
    return int(text) if len(text) <= _LONGEST_INTEGER else _LongInteger(text)


_DECODER = json.JSONDecoder(
    object_pairs_hook=_Pairs, parse_float=_read_float, parse_int=_read_integer, parse_constant=_NotFinite
)


def explain(data: bytes, *, file: str, known_labels: AbstractSet[str], limits: Limits, findings: Findings) -> None:
    """Report everything that is wrong with one file.

    Args:
        data: the file's bytes.
        file: its name in the report.
        known_labels: the data set's classes.
        limits: caps on nesting and on boxes.
        findings: receives the problems; nothing when the file is fine after all.
    """
    before = findings.error_count
    text = _read_text(data, file, findings)
    if text is None or not _check_depth(data, file, limits, findings):
        return
    try:
        document = _DECODER.decode(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        near = quote(text[max(0, error.pos - 20) : error.pos + 20])
        findings.add(Code.INVALID_JSON, file=file, found=near, detail=f"{error.msg}: {place}")
        return
    walk = _Walk(file, known_labels, limits, findings)
    walk.check_everywhere(document, "")
    walk.check_document(document)
    if findings.error_count == before:
        _demand_decodable(data, file, findings)


def _read_text(data: bytes, file: str, findings: Findings) -> str | None:
    """Decode UTF-8, None when that is impossible."""
    if data.startswith(b"\xef\xbb\xbf"):
        findings.add(Code.BYTE_ORDER_MARK, file=file)
        return None
    if data[:4] == b"PK\x03\x04":
        findings.add(Code.NESTED_ARCHIVE, file=file)
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        findings.add(Code.INVALID_UTF8, file=file, detail=f"byte {error.start}: {error.reason}")
        return None


def _check_depth(data: bytes, file: str, limits: Limits, findings: Findings) -> bool:
    """Measure the nesting without recursion, before a recursive decoder sees the file."""
    signs = np.frombuffer(_STRING.sub(b"", data), dtype=np.uint8)
    steps = np.isin(signs, (0x5B, 0x7B)).astype(np.int32) - np.isin(signs, (0x5D, 0x7D))
    depth = int(np.cumsum(steps).max(initial=0))
    if depth > limits.json_depth:
        findings.add(
            Code.NESTED_TOO_DEEPLY, file=file, found=f"{depth} levels", expected=f"at most {limits.json_depth}"
        )
    return depth <= limits.json_depth


def _demand_decodable(data: bytes, file: str, findings: Findings) -> None:
    """Report what the typed decoder refuses although the walk saw nothing (half a surrogate pair, for one)."""
    try:
        msgspec.json.decode(data, type=Document)
        msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        findings.add(Code.INVALID_JSON, file=file, detail=quote(str(error)))


class _Walk:
    """One pass over one document."""

    def __init__(self, file: str, known_labels: AbstractSet[str], limits: Limits, findings: Findings) -> None:
        """Remember where problems go."""
        self._file = file
        self._known_labels = known_labels
        self._limits = limits
        self._findings = findings

    def _add(self, code: Code, pointer: str, *, found: str | None = None, expected: str | None = None) -> None:
        """Note a problem of this file."""
        self._findings.add(code, file=self._file, pointer=pointer, found=found, expected=expected)

    def check_everywhere(self, value: object, pointer: str) -> None:
        """Find repeated keys and numbers that are not finite, in keys of the uploader's own too."""
        if isinstance(value, _NotFinite):
            self._add(Code.NUMBER_NOT_FINITE, pointer, found=quote(value), expected="a finite number")
        elif isinstance(value, _Pairs):
            if len(value) > 1:
                self._check_repeated(value, pointer)
            for key, item in value:
                self.check_everywhere(item, f"{pointer}/{_escape(key)}")
        elif isinstance(value, list):
            for number, item in enumerate(value):
                if isinstance(item, (list, _NotFinite)):
                    self.check_everywhere(item, f"{pointer}/{number}")

    def _check_repeated(self, pairs: _Pairs, pointer: str) -> None:
        """Find keys that stand more than once."""
        counts = Counter(key for key, _ in pairs)
        if len(counts) == len(pairs):
            return
        for key, count in counts.items():
            if count > 1:
                self._add(Code.DUPLICATE_KEY, f"{pointer}/{_escape(key)}", found=f"{count} times", expected="once")

    def check_document(self, document: object) -> None:
        """Hold the document against the format."""
        fields = self._object(document, "", ("objects",))
        if "objects" not in fields:
            return
        boxes = fields["objects"]
        if not _is_array(boxes):
            self._add(Code.WRONG_TYPE, "/objects", found=_describe(boxes), expected="an array of boxes")
            return
        if len(boxes) > self._limits.boxes_per_image:
            expected = f"at most {self._limits.boxes_per_image}"
            self._add(Code.TOO_MANY_BOXES, "/objects", found=f"{len(boxes)} boxes", expected=expected)
        # Those beyond the cap are refused as they are: a file of millions would take minutes to explain.
        for number, box in enumerate(boxes[: self._limits.boxes_per_image]):
            self._check_box(box, f"/objects/{number}")

    def _check_box(self, box: object, pointer: str) -> None:
        """Check one box."""
        fields = self._object(box, pointer, ("2d", "3d", "label", "score"))
        if "label" in fields:
            self._check_label(fields["label"], f"{pointer}/label")
        if "score" in fields:
            self._check_score(fields["score"], f"{pointer}/score")
        if "2d" in fields:
            self._check_2d(fields["2d"], f"{pointer}/2d")
        if "3d" in fields:
            self._check_3d(fields["3d"], f"{pointer}/3d")

    def _check_label(self, label: object, pointer: str) -> None:
        """Check that a label is one of the classes."""
        expected = ", ".join(sorted(self._known_labels))
        if isinstance(label, _Number) or not isinstance(label, str):
            self._add(Code.WRONG_TYPE, pointer, found=_describe(label), expected="a string")
        elif label not in self._known_labels:
            self._add(Code.UNKNOWN_LABEL, pointer, found=quote(label), expected=expected)

    def _check_score(self, value: object, pointer: str) -> None:
        """Check that a score is a number in [0, 1]."""
        score = self._number(value, pointer)
        if score is not None and not score_is_valid(score):
            self._add(Code.SCORE_OUT_OF_RANGE, pointer, found=repr(score), expected="0 to 1")

    def _check_2d(self, value: object, pointer: str) -> None:
        """Check the 2D boxes."""
        fields = self._object(value, pointer, ("amodal",))
        if {"bbox", "bboxVis"} <= fields.keys():
            self._add(Code.CITYPERSONS_KEYS, pointer, found="bbox and bboxVis", expected="amodal and modal alone")
        for key in ("amodal", "modal"):
            if key in fields:
                self._check_rectangle(fields[key], f"{pointer}/{key}")

    def _check_rectangle(self, value: object, pointer: str) -> None:
        """Check one x, y, width, height."""
        box = self._numbers(value, pointer, 4)
        if box is None:
            return
        if min(box[2:]) < 0:
            self._add(Code.BOX_NEGATIVE_SIZE, pointer, found=repr(box), expected="[x, y, width, height]")
        if not box_is_near(box):
            self._add(Code.BOX_OUT_OF_RANGE, pointer, found=repr(box), expected=f"within {BOX_LIMIT_PX:.0f} pixels")

    def _check_3d(self, value: object, pointer: str) -> None:
        """Check centre, dimensions and rotation."""
        fields = self._object(value, pointer, ("center", "dimensions", "rotation"))
        if "center" in fields:
            center = self._numbers(fields["center"], f"{pointer}/center", 3)
            if center is not None and not center_is_valid(center):
                expected = f"within {CENTER_LIMIT_M:.0f} m"
                self._add(Code.CENTER_OUT_OF_RANGE, f"{pointer}/center", found=repr(center), expected=expected)
        if "dimensions" in fields:
            dimensions = self._numbers(fields["dimensions"], f"{pointer}/dimensions", 3)
            for number, dimension in enumerate(dimensions or ()):
                if not dimension_is_valid(dimension):
                    expected = "{} m to {:.0f} m".format(*DIMENSION_RANGE_M)
                    place = f"{pointer}/dimensions/{number}"
                    self._add(Code.DIMENSION_OUT_OF_RANGE, place, found=repr(dimension), expected=expected)
        if "rotation" in fields:
            self._check_rotation(fields["rotation"], f"{pointer}/rotation")

    def _check_rotation(self, value: object, pointer: str) -> None:
        """Check a quaternion's length."""
        rotation = self._numbers(value, pointer, 4)
        if rotation is None:
            return
        norm = math.hypot(*rotation)
        code = Code.ROTATION_NOT_NORMALISED
        if norm < ROTATION_NORM_RANGE[0]:
            code = Code.ROTATION_ZERO
        elif norm > ROTATION_NORM_RANGE[1]:
            code = Code.ROTATION_OUT_OF_RANGE
        elif rotation_is_normalised(norm):
            return
        self._add(code, pointer, found=f"length {norm:.6g}", expected="length 1")

    def _object(self, value: object, pointer: str, required: tuple[str, ...]) -> dict[str, Any]:
        """Take an object's fields, reporting another type and missing keys."""
        if not isinstance(value, _Pairs):
            self._add(Code.WRONG_TYPE, pointer, found=_describe(value), expected="an object")
            return {}
        fields = dict(value)
        for key in required:
            if key not in fields:
                self._add(Code.MISSING_KEY, pointer, expected=f'the key "{key}"')
        return fields

    def _numbers(self, value: object, pointer: str, length: int) -> list[float] | None:
        """Take an array of numbers, None when it is none."""
        if not _is_array(value):
            self._add(Code.WRONG_TYPE, pointer, found=_describe(value), expected=f"an array of {length} numbers")
            return None
        if len(value) != length:
            self._add(Code.WRONG_LENGTH, pointer, found=f"{len(value)} values", expected=f"{length} numbers")
        numbers = [self._number(item, f"{pointer}/{index}") for index, item in enumerate(value)]
        known = [number for number in numbers if number is not None]
        return known if len(known) == length == len(numbers) else None

    def _number(self, value: object, pointer: str) -> float | None:
        """Take a number, None when it is none."""
        if isinstance(value, _LongInteger):
            self._add(Code.NUMBER_TOO_LONG, pointer, found=quote(value), expected="an ordinary number")
        elif isinstance(value, _Number):
            return None  # reported by check_everywhere
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            self._add(Code.WRONG_TYPE, pointer, found=_describe(value), expected="a number")
        else:
            return value
        return None


def _is_array(value: object) -> TypeGuard[list[Any]]:
    """Tell a JSON array from an object."""
    return isinstance(value, list) and not isinstance(value, _Pairs)


def _escape(key: str) -> str:
    """Write a key as part of a JSON pointer (RFC 6901)."""
    return quote(key).replace("~", "~0").replace("/", "~1")


def _describe(value: object) -> str:
    """Name a JSON value and, where short, show it."""
    if isinstance(value, _Number):
        return f"the number {quote(value)}"
    if isinstance(value, str):
        return f'the string "{quote(value)}"'
    if isinstance(value, _Pairs):
        return "an object"
    if isinstance(value, list):
        return f"an array of {len(value)}"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    return f"the number {value!r}"
