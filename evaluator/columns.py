"""Gathers decoded boxes into the arrays of `Predictions`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from evaluator.decoding import Box, LabelLetter
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.record_table import append_rows, floats, letter_codes, make_table, new_rows
from evaluator.value_ranges import Mask, rows_to_explain

_RECORDS_IN_CACHE = 256
"""Records turned into rows at a time: as many as stay in the processor's cache since they were decoded."""

_ROOM = 1.05
"""A little more than the images so far promise, because the system gives memory only where it is written to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Boxes of some files, row by row. Layout as in `Predictions`; N may be 0."""

    image_index: IndexArray
    label_index: IndexArray
    """(N,) index into the known labels; their number for an unknown one."""
    score: Float64Array
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array
    amodal_px: Float64Array
    modal_px: Float64Array

    def rows_to_explain(self, known_labels: int) -> Mask:
        """Find the rows with something to be said, (N,), when so many labels are known."""
        strange = rows_to_explain(
            score=self.score,
            center_m=self.center_m,
            dimensions_m=self.dimensions_m,
            rotation=self.rotation,
            amodal_px=self.amodal_px,
            modal_px=self.modal_px,
        )
        strange |= self.label_index >= known_labels
        return strange

    def of_first_labels(self, count: int) -> "Columns":
        """Keep the rows whose label is one of the first `count` known ones."""
        rows = np.flatnonzero(self.label_index < count)
        if len(rows) == len(self.label_index):
            return self
        return Columns(**{name: getattr(self, name).take(rows, axis=0) for name in Columns.__slots__})


class ColumnBuilder:
    """Gathers the boxes of some files; a box without a modal box gets its amodal one."""

    def __init__(self) -> None:
        """Start empty."""
        self._records: list[Box[LabelLetter]] = []
        self._rows = new_rows()
        self._boxes = 0
        self._amodal_only = 0

    def __len__(self) -> int:
        """Count the boxes."""
        return self._boxes

    def add(self, boxes: Sequence[Box[LabelLetter]]) -> None:
        """Append a file's boxes; the records may be changed, and are not needed afterwards."""
        self._records += boxes
        self._boxes += len(boxes)
        if len(self._records) >= _RECORDS_IN_CACHE:
            self._encode()

    def build(self, image_index: IndexArray) -> tuple[Columns, int]:
        """Make the arrays.

        Args:
            image_index: (N,) int32, the image of each box.

        Returns:
            The columns, and how many of the boxes had a modal box.
        """
        self._encode()
        table = make_table(self._rows)
        columns = Columns(
            image_index=image_index,
            label_index=letter_codes(table),
            score=floats(table, "score"),
            center_m=floats(table, "center"),
            dimensions_m=floats(table, "dimensions"),
            rotation=floats(table, "rotation"),
            amodal_px=floats(table, "amodal"),
            modal_px=floats(table, "modal"),
        )
        return columns, self._boxes - self._amodal_only

    def _encode(self) -> None:
        """Turn the records into rows."""
        if not append_rows(self._rows, self._records):
            self._amodal_only += _fill_modal(self._records)
            if not append_rows(self._rows, self._records):
                raise AssertionError("msgspec no longer writes floats with nine bytes and labels with two")
        self._records.clear()


def _fill_modal(records: Sequence[Box[LabelLetter]]) -> int:
    """Give each box without a modal box its amodal one and count them."""
    amodal_only = [record.box_2d for record in records if record.box_2d.modal is UNSET]
    for box_2d in amodal_only:
        box_2d.modal = box_2d.amodal
    return len(amodal_only)


class GrowingColumns:
    """Gathers the columns of one batch after the other, with room for those to come, so that each is copied once."""

    def __init__(self, *, backwards: bool = False) -> None:
        """Start empty; `backwards`: what is appended comes last box first, and is put before what there is."""
        self._columns, _ = ColumnBuilder().build(np.empty(0, dtype=np.int32))
        self._count = 0
        self._backwards = backwards

    def append(self, columns: Columns, *, share_done: float) -> None:
        """Append a batch's columns.

        Args:
            columns: those of the images that follow.
            share_done: with them, in (0, 1]; where room is short it is made for as many boxes as this promises.
        """
        start, stop = self._count, self._count + len(columns.score)
        if stop > len(self._columns.score):
            self._columns = self._enlarged(max(int(stop / share_done * _ROOM), stop + stop // 2))
        for name in Columns.__slots__:
            self._in_order_of_arrival(getattr(self._columns, name))[start:stop] = getattr(columns, name)
        self._count = stop

    def predictions(self, images: tuple[str, ...], labels: tuple[str, ...]) -> Predictions:
        """Give everything that was appended, in the order of the images."""
        rows = slice(len(self._columns.score) - self._count, None) if self._backwards else slice(self._count)
        return Predictions(
            images=images, labels=labels, **{name: getattr(self._columns, name)[rows] for name in Columns.__slots__}
        )

    def _in_order_of_arrival(self, column: NDArray[Any]) -> NDArray[Any]:
        """View a column so that the first row is the one that came first."""
        return column[::-1] if self._backwards else column

    def _enlarged(self, rows: int) -> Columns:
        """Copy what there is to where there is room for so many rows."""
        enlarged = {}
        for name in Columns.__slots__:
            old = getattr(self._columns, name)
            enlarged[name] = np.empty((rows, *old.shape[1:]), dtype=old.dtype)
            self._in_order_of_arrival(enlarged[name])[: self._count] = self._in_order_of_arrival(old)[: self._count]
        return Columns(**enlarged)
