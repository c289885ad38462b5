"""Reads predictions as the reference does: for comparing numbers on old result folders. The server never uses it.

Follows `loadPredictions` in evaluation/evalObjectDetection3d.py and `fromJsonText` in helpers/annotation.py of
`cityscapesscripts` 2.3.0, and says in notes what they pass over in silence. Where the reference crashes (a box whose
centre is text or infinite, a broken file that belongs to no image) or computes NaN the box or file is skipped; where a
file that is needed cannot be read at all it is an error here, too.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.archive import MemberError, Source, digest_of_files
from evaluator.codes import Code
from evaluator.findings import Findings, quote
from evaluator.limits import Limits
from evaluator.predictions import Predictions

NO_LIMITS = Limits(
    archive_bytes=2**62,
    entries=2**31,
    expanded_bytes=2**62,
    file_bytes=2**62,
    ratio=2**31,
    json_depth=2**31,
    boxes_per_image=2**31,
)
_RESULTS_FILE = "results.json"
_FARTHEST_M = 2.0**63
"""The reference's depths are integers of 64 bits."""
_WIDTHS = {"center_m": 3, "dimensions_m": 3, "rotation": 4, "amodal_px": 4, "modal_px": 4}


class LinkFollowingFolder:
    """Every JSON file below a folder, as `os.walk` and `open` give them to the reference."""

    def __init__(self, root: Path) -> None:
        """List the files."""
        self._root = root
        self.names: Sequence[str] = [path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()]

    def read(self, number: int) -> bytes:
        """Read one file."""
        try:
            return (self._root / self.names[number]).read_bytes()
        except OSError as error:
            raise MemberError(Code.UNREADABLE, str(error.strerror)) from None

    def sha256(self) -> str:
        """Compute the SHA-256 as `digest` does, but of what the links lead to; empty when unreadable."""
        try:
            return digest_of_files(self._root, self.names)
        except OSError:
            return ""


class LenientReading:
    """One lenient reading of all files."""

    def __init__(self, images: tuple[str, ...], labels: tuple[str, ...], findings: Findings) -> None:
        """Start without boxes."""
        self._images = images
        self._labels = labels
        self._findings = findings
        self.images_found = 0
        self.rows: list[dict[str, Any]] = []

    def read(self, files: Source) -> None:
        """Read the file of every image in the order of the images."""
        file_of = self._assign(files.names)
        self.images_found = len(file_of)
        for index, image in enumerate(self._images):
            if image in file_of:
                name = files.names[file_of[image]]
                for box in self._boxes(files, file_of[image], name):
                    self.rows.append({"image_index": index, **box})
            else:
                self._findings.add(Code.LENIENT_MISSING_IMAGE, expected=f"{image}_<anything>.json")

    def _assign(self, names: Sequence[str]) -> dict[str, int]:
        """Find each image's file: its name up to the last underscore, the last in sorted order winning."""
        wanted = frozenset(self._images)
        file_of: dict[str, int] = {}
        for number in sorted(range(len(names)), key=names.__getitem__):
            base = names[number].rpartition("/")[2]
            if not base.endswith(".json") or base == _RESULTS_FILE:
                continue
            image = base[: base.rfind("_")]
            if image not in wanted:
                self._findings.add(Code.LENIENT_EXTRA_FILE, file=names[number])
                continue
            if image in file_of:
                self._findings.add(Code.LENIENT_REPLACED_FILE, file=names[file_of[image]], detail=f"by {quote(base)}")
            file_of[image] = number
        return file_of

    def _boxes(self, files: Source, number: int, name: str) -> Iterator[dict[str, Any]]:
        """Yield the boxes of one file that the reference counts."""
        try:
            document = json.loads(files.read(number).decode("utf-8"))
            boxes = list(document["objects"])
        except MemberError as error:
            self._findings.add(error.code, file=name, detail=error.detail)
        except UnicodeDecodeError as error:
            self._findings.add(Code.INVALID_UTF8, file=name, detail=str(error))
        except (ValueError, RecursionError) as error:
            self._findings.add(Code.INVALID_JSON, file=name, detail=quote(str(error)))
        except (KeyError, TypeError):
            self._findings.add(Code.MISSING_KEY, file=name, pointer="", expected='an object with a list "objects"')
        else:
            for place, box in enumerate(boxes):
                yield from self._take(box, name, f"/objects/{place}")

    def _take(self, box: object, name: str, pointer: str) -> Iterator[dict[str, Any]]:
        """Yield the box if the reference counts it, and say so if not."""
        label = box.get("label") if isinstance(box, dict) else None
        if isinstance(box, dict) and label not in self._labels:
            found = quote(json.dumps(label)) if "label" in box else "no label"
            self._findings.add(Code.LENIENT_SKIPPED_LABEL, file=name, pointer=pointer, found=found)
            return
        try:
            row = _read_box(box)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            detail = quote(f"{type(error).__name__}: {error}")
            self._findings.add(Code.LENIENT_SKIPPED_OBJECT, file=name, pointer=pointer, detail=detail)
            return
        if not 0.0 <= row["score"] <= 1.0:
            found = repr(row["score"])
            self._findings.add(Code.LENIENT_SCORE, file=name, pointer=f"{pointer}/score", found=found)
        yield {"label_index": self._labels.index(str(label)), **row}

    def predictions(self) -> Predictions:
        """Make the arrays."""
        columns: dict[str, Any] = {
            key: np.array([row[key] for row in self.rows], dtype=np.int32) for key in ("image_index", "label_index")
        }
        columns["score"] = np.array([row["score"] for row in self.rows], dtype=np.float64)
        for key, width in _WIDTHS.items():
            columns[key] = np.array([row[key] for row in self.rows], dtype=np.float64).reshape(-1, width)
        return Predictions(images=self._images, labels=self._labels, **columns)


def _read_box(box: Any) -> dict[str, Any]:  # noqa: ANN401 -- any JSON value; a wrong one raises
    """Read one box, raising KeyError, TypeError, ValueError or AttributeError where the reference fails on it."""
    amodal, modal = _rectangles(box["2d"])
    return {"score": _score(box["score"]), **_space(box["3d"]), "amodal_px": amodal, "modal_px": modal}


def _space(fields: Mapping[str, Any]) -> dict[str, list[float]]:
    """Read the 3D box; the reference crashes on most of those that are not finite or too far away."""
    box = {
        "center_m": _numbers(fields["center"], 3),
        "dimensions_m": _numbers(fields["dimensions"][:3], 3),
        "rotation": _numbers([float(value) for value in fields["rotation"]], 4),
    }
    if not all(map(math.isfinite, chain.from_iterable(box.values()))):
        raise ValueError("center, dimensions and rotation must be finite")
    if math.hypot(*box["center_m"]) >= _FARTHEST_M:
        raise ValueError("center is too far away")
    return box


def _rectangles(fields: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    """Choose between the keys as `CsBbox2d.fromJsonText` does; a broken amodal box beside a modal one is never used."""
    keys = fields.keys()
    if "bbox" in keys and "bboxVis" in keys:
        amodal, modal = fields["bbox"], fields["bboxVis"]
    elif "modal" in keys and "amodal" in keys:
        amodal, modal = fields["amodal"], fields["modal"]
    else:
        amodal = modal = fields["amodal"]
    read_modal = _numbers(modal[:4], 4)
    try:
        return _numbers(amodal[:4], 4), read_modal
    except (TypeError, ValueError):
        return read_modal, read_modal


def _score(value: object) -> float:
    """Read a score; an array of one number compares like the number."""
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    return _number(value)


def _numbers(values: object, length: int) -> list[float]:
    """Read an array of numbers."""
    if not isinstance(values, list) or len(values) != length:
        raise ValueError(f"expected {length} numbers")
    return [_number(value) for value in values]


def _number(value: object) -> float:
    """Read a number; true and false are 1 and 0, and integers beyond a float's range are infinite."""
    if not isinstance(value, (int, float)):
        raise TypeError(f"expected a number, not {type(value).__name__}")
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
