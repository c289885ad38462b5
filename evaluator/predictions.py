"""Predictions as arrays: what decoding yields and matching takes."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from evaluator import array_file

Float64Array = NDArray[np.float64]
IndexArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictions:
    """All predictions of one submission, ordered by image, then as they stand in the image's file.

    Rows are boxes of the evaluated `labels` only. Frame: ISO 8855 vehicle frame (x forward, y left, z up,
    origin on the ground below the rear axle), metres. No boxes at all is valid: every array has length 0.
    """

    images: tuple[str, ...]
    """Image names `<city>_<sequence>_<frame>`, in the ground truth's order."""
    labels: tuple[str, ...]
    """What `label_index` refers to."""
    image_index: IndexArray
    """(N,) int32, ascending, index into `images`."""
    label_index: IndexArray
    """(N,) int32, index into `labels`."""
    score: Float64Array
    """(N,) confidence."""
    center_m: Float64Array
    """(N, 3) box centres x, y, z."""
    dimensions_m: Float64Array
    """(N, 3) length, width, height."""
    rotation: Float64Array
    """(N, 4) quaternions w, x, y, z as submitted (the evaluation normalises them)."""
    amodal_px: Float64Array
    """(N, 4) submitted amodal box: x, y of the upper left corner, width, height."""
    modal_px: Float64Array
    """(N, 4) submitted modal box, the same layout; the amodal one where the file has none."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.score)

    def to_bytes(self) -> bytes:
        """Write everything to deterministic bytes (evaluator/array_file.py): read once, evaluated in many places."""
        return array_file.pack_fields(self)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote.

        Raises:
            ArrayFileError: The bytes are something else or are cut short.
        """
        return cls(**array_file.unpack_fields(data, cls, what="predictions"))
