"""Gathers decoded boxes into the arrays of `Predictions`, a few thousand at a time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from evaluator.decoding import Box, Box2d
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.record_table import floats, tabulate_2d, tabulate_3d
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


def gather(boxes: Sequence[Box], image_index: IndexArray, label_numbers: dict[str, int]) -> tuple[Columns, int]:
    """Turn records into arrays; a box without a modal box gets its amodal one.

    Args:
        boxes: N decoded boxes.
        image_index: (N,) int32, the image of each.
        label_numbers: index of each evaluated label; `NOT_EVALUATED` for the others that are known.

    Returns:
        The arrays, and how many boxes had a modal box.
    """
    in_space = tabulate_3d([box.box_3d for box in boxes])
    in_image, modal = _tabulate_2d([box.box_2d for box in boxes])
    columns = Columns(
        image_index=image_index,
        label_index=np.array([label_numbers.get(box.label, UNKNOWN) for box in boxes], dtype=np.int32),
        score=np.array([box.score for box in boxes], dtype=np.float64),
        center_m=floats(in_space, "center"),
        dimensions_m=floats(in_space, "dimensions"),
        rotation=floats(in_space, "rotation"),
        amodal_px=floats(in_image, "amodal"),
        modal_px=floats(in_image, "modal"),
    )
    return columns, modal


def _tabulate_2d(records: Sequence[Box2d]) -> tuple[NDArray[Any], int]:
    """Tabulate the 2D boxes and count the modal ones among them."""
    table = tabulate_2d(records)
    if table is not None:
        return table, len(records)
    amodal_only = [record for record in records if record.modal is UNSET]
    for record in amodal_only:
        record.modal = record.amodal
    table = tabulate_2d(records)
    if table is None:
        raise AssertionError("every 2D box has been completed")
    return table, len(records) - len(amodal_only)


def concatenate(parts: Sequence[Columns], images: tuple[str, ...], labels: tuple[str, ...]) -> Predictions:
    """Join parts, in the order of the images, into predictions."""
    parts = [gather((), np.empty(0, dtype=np.int32), {})[0], *parts]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Columns.__slots__}
    return Predictions(images=images, labels=labels, **joined)
