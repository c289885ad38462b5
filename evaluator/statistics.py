"""What every score is computed from: the outcome of each box, image by image.

A submission's statistics are kept with its score: 1.5 MB with 30 predictions in each of 1525 images, 4.1 MB with 100.
Scores of any subset or resample of the images follow from them without matching again (evaluator/uncertainty.py), and
those of disjoint parts of the images can be joined (evaluator/parallel.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import msgspec
import numpy as np

from evaluator import array_file
from evaluator.depth import depth_bin_index
from evaluator.ground_truth import GroundTruth
from evaluator.matching import Matches, class_index, evaluated_labels
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.protocol import Protocol, Signature
from evaluator.thresholds import MaskArray
from evaluator.true_positive_metrics import pair_similarities


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """Outcomes of G ground-truth boxes of evaluated classes, P matched pairs and F false positives.

    A cell is one class in one depth bin: `class * (bins + 1) + bin`; bin `bins` is at or beyond the maximum depth.
    Ground truth and pairs are in the cell of the ground truth, false positives in that of the prediction (paper,
    section Depth-Dependent Average Precision). Masks are sets of score thresholds (evaluator/thresholds.py).
    """

    signature: Signature
    """What they, and whatever is computed from them, depend on."""
    images: tuple[str, ...]
    thresholds: Float64Array

    ground_truth_image: IndexArray
    """(G,) int32, index into `images`."""
    ground_truth_cell: IndexArray
    pair_image: IndexArray
    """(P,) int32."""
    pair_cell: IndexArray
    pair_masks: MaskArray
    """(P,) thresholds at which the pair is a true positive."""
    pair_score: Float64Array
    pair_similarities: Float64Array
    """(P, 4) in the order of `SIMILARITIES`."""
    false_positive_image: IndexArray
    """(F,) int32."""
    false_positive_cell: IndexArray
    false_positive_masks: MaskArray
    false_positive_score: Float64Array

    @property
    def protocol(self) -> Protocol:
        """The rules that boxes were matched by."""
        return self.signature.protocol

    @property
    def labels(self) -> tuple[str, ...]:
        """The evaluated classes, in the order of the cells."""
        return evaluated_labels(self.protocol)

    @property
    def grid(self) -> tuple[int, int]:
        """Number of classes, and of depth bins with the one beyond the maximum depth."""
        return len(self.labels), len(self.protocol.depth_bins_m) + 1

    def to_bytes(self) -> bytes:
        """Write everything to deterministic bytes (evaluator/array_file.py)."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        return array_file.pack({"signature": msgspec.to_builtins(self.signature), "images": self.images}, arrays)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote.

        Raises:
            ArrayFileError: The bytes are something else or are cut short.
        """
        facts, arrays = array_file.unpack(data)
        if facts.keys() | arrays.keys() != {field.name for field in fields(cls)}:
            raise array_file.ArrayFileError("The array file does not hold statistics; evaluate the submission again.")
        values: dict[str, Any] = dict(arrays)
        signature = msgspec.convert(facts["signature"], Signature)
        return cls(signature=signature, images=tuple(facts["images"]), **values)


def join(parts: Sequence[Statistics]) -> Statistics:
    """Join the statistics of disjoint parts of the images, in the order of the images.

    Args:
        parts: At least one; all under the same protocol.

    Returns:
        Bit for bit what evaluating all images at once gives, with the signature of the first part.
    """
    before = np.cumsum([0, *(len(part.images) for part in parts)])[:-1].astype(np.int32)
    joined: dict[str, Any] = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(Statistics)
        if field.name not in {"signature", "images", "thresholds"}
    }
    for name in ("ground_truth_image", "pair_image", "false_positive_image"):
        joined[name] = np.concatenate([getattr(p, name) + offset for p, offset in zip(parts, before, strict=True)])
    images = tuple(image for part in parts for image in part.images)
    return Statistics(signature=parts[0].signature, images=images, thresholds=parts[0].thresholds, **joined)


def collect(ground_truth: GroundTruth, predictions: Predictions, matches: Matches, signature: Signature) -> Statistics:
    """Gather the outcomes of one evaluation, which the signature tells of."""
    protocol = signature.protocol
    gt_cell = _cells(ground_truth, protocol)
    prediction_cell = _cells(predictions, protocol)
    evaluated = np.flatnonzero(gt_cell >= 0)
    gt_row, prediction_row = matches.ground_truth_index, matches.prediction_index
    wrong = np.flatnonzero(matches.false_positive_thresholds * (prediction_cell >= 0))
    return Statistics(
        signature=signature,
        images=ground_truth.images,
        thresholds=matches.thresholds,
        ground_truth_image=ground_truth.image_index[evaluated],
        ground_truth_cell=gt_cell[evaluated],
        pair_image=ground_truth.image_index[gt_row],
        pair_cell=gt_cell[gt_row],
        pair_masks=matches.pair_thresholds,
        pair_score=predictions.score[prediction_row],
        pair_similarities=pair_similarities(
            (ground_truth.center_m.take(gt_row, axis=0), predictions.center_m.take(prediction_row, axis=0)),
            (ground_truth.dimensions_m.take(gt_row, axis=0), predictions.dimensions_m.take(prediction_row, axis=0)),
            (ground_truth.rotation.take(gt_row, axis=0), predictions.rotation.take(prediction_row, axis=0)),
            float(protocol.max_depth_m),
        ),
        false_positive_image=predictions.image_index[wrong],
        false_positive_cell=prediction_cell[wrong],
        false_positive_masks=matches.false_positive_thresholds[wrong],
        false_positive_score=predictions.score[wrong],
    )


def _cells(boxes: GroundTruth | Predictions, protocol: Protocol) -> IndexArray:
    """Return the cell of each box, -1 for labels not evaluated."""
    label = class_index(boxes.labels, boxes.label_index, protocol)
    bins = len(protocol.depth_bins_m) + 1
    return np.where(label < 0, -1, label * bins + depth_bin_index(boxes.center_m, protocol)).astype(np.int32)
