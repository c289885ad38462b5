"""Gathers decoded boxes into the arrays of `Predictions`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import UNSET

from evaluator.decoding import Box, Box2d, Box3d
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.record_table import ROW_2D, ROW_3D, encode_rows, floats, make_table
from evaluator.value_ranges import Mask, rows_to_explain

NOT_EVALUATED = -1
UNKNOWN = -2


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Boxes of some files, row by row. Layout as in `Predictions`; N may be 0."""

    image_index: IndexArray
    label_index: IndexArray
    """(N,) index into the evaluated labels, `NOT_EVALUATED` or `UNKNOWN`."""
    score: Float64Array
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array
    amodal_px: Float64Array
    modal_px: Float64Array

    def rows_to_explain(self) -> Mask:
        """Find the rows with something to be said, (N,)."""
        strange = rows_to_explain(
            score=self.score,
            center_m=self.center_m,
            dimensions_m=self.dimensions_m,
            rotation=self.rotation,
            amodal_px=self.amodal_px,
            modal_px=self.modal_px,
        )
        strange |= self.label_index == UNKNOWN
        return strange

    def evaluated(self) -> "Columns":
        """Keep the rows of evaluated labels."""
        keep = self.label_index >= 0
        if keep.all():
            return self
        return Columns(**{name: getattr(self, name)[keep] for name in Columns.__slots__})


class ColumnBuilder:
    """Gathers the boxes of some files; a box without a modal box gets its amodal one."""

    def __init__(self, label_numbers: dict[str, int]) -> None:
        """Start empty.

        Args:
            label_numbers: index of each evaluated label; `NOT_EVALUATED` for the others that are known.
        """
        self._label_numbers = label_numbers
        self._rows_2d: list[bytes] = []
        self._rows_3d: list[bytes] = []
        self._scores: list[float] = []
        self.labels: list[str] = []
        self.modal = 0
        """How many boxes had a modal box."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.labels)

    def add(self, boxes: Sequence[Box]) -> None:
        """Append a file's boxes; the records are not needed afterwards."""
        self._rows_3d.append(_complete_rows([box.box_3d for box in boxes], ROW_3D))
        in_image = [box.box_2d for box in boxes]
        rows = encode_rows(in_image, ROW_2D)
        self.modal += len(boxes)
        if rows is None:
            self.modal -= _fill_modal(in_image)
            rows = _complete_rows(in_image, ROW_2D)
        self._rows_2d.append(rows)
        self._scores += [box.score for box in boxes]
        self.labels += [box.label for box in boxes]

    def build(self, image_index: IndexArray) -> Columns:
        """Make the arrays.

        Args:
            image_index: (N,) int32, the image of each box.
        """
        in_image, in_space = make_table(self._rows_2d, ROW_2D), make_table(self._rows_3d, ROW_3D)
        numbers = [self._label_numbers.get(label, UNKNOWN) for label in self.labels]
        return Columns(
            image_index=image_index,
            label_index=np.array(numbers, dtype=np.int32),
            score=np.array(self._scores, dtype=np.float64),
            center_m=floats(in_space, "center"),
            dimensions_m=floats(in_space, "dimensions"),
            rotation=floats(in_space, "rotation"),
            amodal_px=floats(in_image, "amodal"),
            modal_px=floats(in_image, "modal"),
        )


def _fill_modal(records: Sequence[Box2d]) -> int:
    """Give each box without a modal box its amodal one and count them."""
    amodal_only = [record for record in records if record.modal is UNSET]
    for record in amodal_only:
        record.modal = record.amodal
    return len(amodal_only)


def _complete_rows(records: Sequence[Box2d] | Sequence[Box3d], row: np.dtype[Any]) -> bytes:
    """Encode records that have every field."""
    rows = encode_rows(records, row)
    if rows is None:
        raise AssertionError("msgspec no longer writes floats with nine bytes")
    return rows


def concatenate(parts: Sequence[Columns], images: tuple[str, ...], labels: tuple[str, ...]) -> Predictions:
    """Join parts, in the order of the images, into predictions."""
    parts = [ColumnBuilder({}).build(np.empty(0, dtype=np.int32)), *parts]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Columns.__slots__}
    return Predictions(images=images, labels=labels, **joined)
