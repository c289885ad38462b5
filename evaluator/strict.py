"""The strict reading: clean files fast to arrays, the others explained."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from evaluator.archive import MemberError, Source
from evaluator.codes import Code
from evaluator.columns import ColumnBuilder, Columns, GrowingColumns
from evaluator.decoding import (
    MOST_LABELS,
    Box,
    LabelLetter,
    box_decoder,
    count_colons,
    extra_keys_are_clean,
    keys_are_expected,
)
from evaluator.errors import UsageError
from evaluator.explanation import explain
from evaluator.file_names import assign_files
from evaluator.findings import Findings
from evaluator.limits import Limits
from evaluator.predictions import IndexArray, Predictions
from evaluator.protocol import VEHICLE_LABELS

Progress = Callable[[int, int], None]
"""Called with the images done and the images in all."""

_BATCH_BOXES = 4096
_BATCH_BYTES = 32 * 1024 * 1024


class StrictReading:
    """One reading of all files, in the order of the images."""

    def __init__(
        self, files: Source, images: Sequence[str] | None, labels: tuple[str, ...], limits: Limits, findings: Findings
    ) -> None:
        """Find each image's file.

        Raises:
            UsageError: There are too many labels.
        """
        self._files = files
        self._labels = labels
        self._limits = limits
        self._findings = findings
        self.known_labels = frozenset((*VEHICLE_LABELS, *labels))
        if len(self.known_labels) > MOST_LABELS:
            own = MOST_LABELS - len(VEHICLE_LABELS)
            raise UsageError(f"There are too many labels; name {own} at most beside those of the data set.")
        self._labels_in_order = (*labels, *sorted(self.known_labels - set(labels)))
        self._decoder = box_decoder(self._labels_in_order)
        self.label_counts = np.zeros(len(self._labels_in_order), dtype=np.int64)
        self._explained: set[int] = set()
        self._explained_bytes = 0
        self.boxes = 0
        self.images, self.assigned = assign_files(files.names, images, findings)
        if not self.assigned and Code.UNKNOWN_IMAGE not in findings:
            findings.add(Code.EMPTY_ARCHIVE)

    def read(self, progress: Progress | None) -> Predictions:
        """Read every file, batch by batch."""
        return self._read(self.assigned, len(self.assigned), progress).predictions(self.images, self._labels)

    def read_part(self, files: Iterable[tuple[int, int]], *, backwards: bool) -> Predictions:
        """Read some files, about half of all.

        Args:
            files: pairs of `assigned`, one after the other, which are asked for only when their turn comes.
            backwards: they come last image first; the boxes are in the usual order all the same.
        """
        columns = self._read(files, len(self.assigned) / 2, None, backwards=backwards)
        return columns.predictions(self.images, self._labels)

    def _read(
        self, files: Iterable[tuple[int, int]], expected: float, progress: Progress | None, *, backwards: bool = False
    ) -> GrowingColumns:
        """Read files, of which so many are expected; where they come backwards, so do the boxes of each."""
        columns = GrowingColumns(backwards=backwards)
        batch = _Batch()
        done = finished = 0
        for done, (image, number) in enumerate(files, start=1):
            data = self._read_bytes(number)
            boxes = None if data is None else self._decode(number, data)
            if data is not None and boxes is not None:
                batch.add(image, number, data, boxes[::-1] if backwards else boxes)
            if batch.is_full:
                columns.append(self._finish(batch), share_done=min(1.0, done / expected))
                batch, finished = _Batch(), done
                if progress is not None:
                    progress(done, len(self.assigned))
        if finished < done:
            columns.append(self._finish(batch), share_done=1.0)
            if progress is not None:
                progress(done, len(self.assigned))
        return columns

    def note_unevaluated_labels(self) -> None:
        """Note which of the data set's other classes there were boxes of."""
        for number in range(len(self._labels), len(self._labels_in_order)):
            if count := int(self.label_counts[number]):
                self._findings.add(Code.UNEVALUATED_LABEL, found=self._labels_in_order[number], count=count)

    def _read_bytes(self, number: int) -> bytes | None:
        """Read one file, reporting when that is impossible."""
        try:
            return self._files.read(number)
        except MemberError as error:
            self._findings.add(error.code, file=self._files.names[number], detail=error.detail)
            return None

    def _decode(self, number: int, data: bytes) -> Sequence[Box[LabelLetter]] | None:
        """Decode one file; None when that fails, which is then explained."""
        boxes = self._decoder.decode(data)
        if boxes is not None and len(boxes) <= self._limits.boxes_per_image:
            return boxes
        self._explain(number, data)
        return None

    def _explain(self, number: int, data: bytes) -> None:
        """Report what is wrong with one file, once."""
        if number in self._explained:
            return
        self._explained.add(number)
        self._explained_bytes += len(data)
        if self._explained_bytes > self._limits.explained_bytes:
            self._findings.add(Code.NOT_EXPLAINED, file=self._files.names[number])
            return
        explain(
            data,
            file=self._files.names[number],
            known_labels=self.known_labels,
            limits=self._limits,
            findings=self._findings,
        )

    def _finish(self, batch: "_Batch") -> Columns:
        """Turn a batch into arrays and explain the files with keys or values that are not as they should be."""
        columns, modal = batch.columns.build(batch.image_index)
        known = len(self._labels_in_order)
        strange = columns.rows_to_explain(known)  # at once, while the columns are in the processor's cache
        boxes = len(batch.columns)
        if not keys_are_expected(colons=count_colons(batch.data), files=len(batch.data), boxes=boxes, modal=modal):
            for number, data in zip(batch.numbers, batch.data, strict=True):
                if not extra_keys_are_clean(data, self._limits.json_depth):
                    self._explain(number, data)
        if strange.any():
            for place in np.unique(batch.file_index[strange]):
                self._explain(batch.numbers[place], batch.data[place])
        self.label_counts += np.bincount(columns.label_index, minlength=known)[:known]
        evaluated = columns.of_first_labels(len(self._labels))
        self.boxes += len(evaluated.score)
        return evaluated


class _Batch:
    """Some files' boxes, with the bytes they came from in case they need explaining."""

    def __init__(self) -> None:
        """Start empty."""
        self.columns = ColumnBuilder()
        self.numbers: list[int] = []
        self.data: list[bytes] = []
        self.images: list[int] = []
        self.counts: list[int] = []
        self._bytes = 0

    def add(self, image: int, number: int, data: bytes, boxes: Sequence[Box[LabelLetter]]) -> None:
        """Append one file."""
        self.columns.add(boxes)
        self.numbers.append(number)
        self.data.append(data)
        self.images.append(image)
        self.counts.append(len(boxes))
        self._bytes += len(data)

    @property
    def is_full(self) -> bool:
        """Tell when to turn it into arrays."""
        return len(self.columns) >= _BATCH_BOXES or self._bytes >= _BATCH_BYTES

    @property
    def image_index(self) -> IndexArray:
        """(N,) int32, the image of each box."""
        return np.repeat(np.array(self.images, dtype=np.int32), self.counts)

    @property
    def file_index(self) -> IndexArray:
        """(N,) int32, the place in this batch of each box's file."""
        return np.repeat(np.arange(len(self.counts), dtype=np.int32), self.counts)
