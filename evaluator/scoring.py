"""From statistics to scores: the aggregation every number of a result comes from.

Paper, section Benchmark Metrics; reference: `_calculateAp`, `_calcTpStats`. The protocol `paper` aggregates in
evaluator/paper_scoring.py; both end in `assemble`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall, working_point_index
from evaluator.predictions import Float64Array
from evaluator.protocol import Protocol, Signature
from evaluator.results import ClassScore, DepthBin, Scores
from evaluator.statistics import Statistics
from evaluator.thresholds import count_by_group, has_threshold
from evaluator.true_positive_metrics import SIMILARITIES, mean_over_bins


@dataclass(frozen=True, slots=True)
class Counts:
    """Outcomes in each cell: C classes, B depth bins (the last one beyond the maximum depth), T thresholds."""

    ground_truth: NDArray[np.int64]
    """(C, B)."""
    true_positives: NDArray[np.int64]
    """(C, B, T)."""
    false_positives: NDArray[np.int64]
    """(C, B, T)."""


@dataclass(frozen=True, slots=True)
class TruePositives:
    """The true positives at the working point: C classes, B depth bins without the one beyond."""

    counts: NDArray[np.int64]
    """(C, B)."""
    sums: Float64Array
    """(C, B, 4) sums of the similarities."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Aggregates:
    """What a result is assembled from, for C classes, B depth bins without the one beyond, T thresholds."""

    counts: Counts
    ap: Float64Array
    """(C,)."""
    depth_ap: Float64Array
    """(C, B)."""
    working_point: Float64Array
    """(C,) c_w."""
    true_positives: TruePositives
    similarities: Float64Array
    """(C, 4)."""


def score(statistics: Statistics) -> Scores:
    """Compute the whole result by the protocol `cityscapes3d`.

    Args:
        statistics: Outcomes of all images.

    Returns:
        The scores; None wherever there is no ground truth to measure on.
    """
    counts = count(statistics)
    precision, recall = class_curves(counts)
    working = working_point_index(precision, recall, statistics.thresholds, statistics.protocol.working_point)
    point_of_pair = working[statistics.pair_cell // statistics.grid[1]]
    true_positives = sum_true_positives(statistics, has_threshold(statistics.pair_masks, point_of_pair))
    aggregates = Aggregates(
        counts=counts,
        ap=average_precision(precision, recall),
        depth_ap=average_precision(*depth_curves(counts)),
        working_point=statistics.thresholds[working],
        true_positives=true_positives,
        similarities=mean_over_bins(true_positives.sums, true_positives.counts),
    )
    return assemble(statistics, aggregates)


def count(statistics: Statistics) -> Counts:
    """Count the outcomes of all images."""
    classes, bins = statistics.grid
    shape, cells, thresholds = (classes, bins, -1), classes * bins, len(statistics.thresholds)
    return Counts(
        ground_truth=np.bincount(statistics.ground_truth_cell, minlength=cells).reshape(classes, bins),
        true_positives=count_by_group(statistics.pair_cell, statistics.pair_masks, cells, thresholds).reshape(shape),
        false_positives=count_by_group(
            statistics.false_positive_cell, statistics.false_positive_masks, cells, thresholds
        ).reshape(shape),
    )


def class_curves(counts: Counts) -> tuple[Float64Array, Float64Array]:
    """Return precision and recall of each class at all depths, (C, T)."""
    return precision_and_recall(
        counts.true_positives.sum(axis=1), counts.false_positives.sum(axis=1), counts.ground_truth.sum(axis=1)
    )


def depth_curves(counts: Counts) -> tuple[Float64Array, Float64Array]:
    """Return precision and recall in each depth bin, (C, B, T)."""
    return precision_and_recall(
        counts.true_positives[:, :-1], counts.false_positives[:, :-1], counts.ground_truth[:, :-1]
    )


def sum_true_positives(statistics: Statistics, wanted: NDArray[np.bool_]) -> TruePositives:
    """Sum up the similarities of the wanted ones of P pairs."""
    classes, bins = statistics.grid
    cell = statistics.pair_cell[wanted]
    similarities = statistics.pair_similarities[wanted]
    sums = np.zeros((classes * bins, similarities.shape[1]))
    for column in range(similarities.shape[1]):
        sums[:, column] = np.bincount(cell, weights=similarities[:, column], minlength=classes * bins)
    counts = np.bincount(cell, minlength=classes * bins).reshape(classes, bins)
    return TruePositives(counts[:, :-1], sums.reshape(classes, bins, -1)[:, :-1])


def assemble(statistics: Statistics, aggregates: Aggregates) -> Scores:
    """Put the numbers into a result, None for whatever has no ground truth."""
    precision, recall = class_curves(aggregates.counts)
    depth_bins = _depth_bins(statistics.protocol, aggregates)
    classes = tuple(
        _class_score(
            label=label,
            ground_truth_count=int(aggregates.counts.ground_truth[index].sum()),
            ap=float(aggregates.ap[index]),
            similarities=aggregates.similarities[index].tolist(),
            working_point=float(aggregates.working_point[index]),
            curve=(recall[index].tolist(), precision[index].tolist()),
            depth_bins=depth_bins[index],
        )
        for index, label in enumerate(statistics.labels)
    )
    return _with_means(statistics.signature, statistics.thresholds, classes)


def _class_score(
    *,
    label: str,
    ground_truth_count: int,
    ap: float,
    similarities: list[float],
    working_point: float,
    curve: tuple[list[float], list[float]],
    depth_bins: tuple[DepthBin, ...],
) -> ClassScore:
    if ground_truth_count == 0:
        return _undefined_class(label, depth_bins)
    bevcd, yaw_sim, pr_sim, size_sim = similarities
    return ClassScore(
        label=label,
        ground_truth_count=ground_truth_count,
        ap=ap,
        bevcd=bevcd,
        yaw_sim=yaw_sim,
        pr_sim=pr_sim,
        size_sim=size_sim,
        detection_score=detection_score(ap, similarities),
        working_point=working_point,
        recall=tuple(curve[0]),
        precision=tuple(curve[1]),
        depth_bins=depth_bins,
    )


def detection_score(ap: float, similarities: list[float]) -> float:
    """Combine AP with the four similarities: AP x their mean (paper, section Detection Score); in [0, AP]."""
    bevcd, yaw_sim, pr_sim, size_sim = similarities
    return ap * (bevcd + size_sim + yaw_sim + pr_sim) / 4.0


def _undefined_class(label: str, depth_bins: tuple[DepthBin, ...]) -> ClassScore:
    return ClassScore(
        label=label,
        ground_truth_count=0,
        ap=None,
        bevcd=None,
        yaw_sim=None,
        pr_sim=None,
        size_sim=None,
        detection_score=None,
        working_point=None,
        recall=(),
        precision=(),
        depth_bins=depth_bins,
    )


def _depth_bins(protocol: Protocol, aggregates: Aggregates) -> list[tuple[DepthBin, ...]]:
    """Return the depth bins of each class."""
    found = aggregates.true_positives
    means = found.sums / np.maximum(found.counts, 1)[..., None]
    ground_truth = aggregates.counts.ground_truth[:, :-1]
    # All at once: taken out of arrays one by one, numbers cost more than everything else here.
    columns = (ground_truth, aggregates.depth_ap, *depth_curves(aggregates.counts), found.counts, means)
    classes = zip(*(column.tolist() for column in columns), strict=True)
    ranges_m = [
        (lower_m, min(lower_m + protocol.depth_step_m, protocol.max_depth_m)) for lower_m in protocol.depth_bins_m
    ]
    return [
        tuple(
            _depth_bin(range_m=range_m, boxes=boxes, ap=ap, curve=(recall, precision), found=matched, means=own)
            for range_m, boxes, ap, precision, recall, matched, own in zip(ranges_m, *of_class, strict=True)
        )
        for of_class in classes
    ]


def _depth_bin(
    *,
    range_m: tuple[int, int],
    boxes: int,
    ap: float,
    curve: tuple[list[float], list[float]],
    found: int,
    means: list[float],
) -> DepthBin:
    defined = means if found else [None] * len(SIMILARITIES)
    recall, precision = map(tuple, curve if boxes else ((), ()))
    return DepthBin(
        lower_m=range_m[0],
        upper_m=range_m[1],
        ground_truth_count=boxes,
        ap=ap if boxes else None,
        recall=recall,
        precision=precision,
        true_positive_count=found,
        **dict(zip(SIMILARITIES, defined, strict=True)),
    )


def _with_means(signature: Signature, thresholds: Float64Array, classes: tuple[ClassScore, ...]) -> Scores:
    return Scores(
        signature=signature,
        mds=_mean([item.detection_score for item in classes]),
        map=_mean([item.ap for item in classes]),
        mbevcd=_mean([item.bevcd for item in classes]),
        myaw_sim=_mean([item.yaw_sim for item in classes]),
        mpr_sim=_mean([item.pr_sim for item in classes]),
        msize_sim=_mean([item.size_sim for item in classes]),
        thresholds=tuple(thresholds.tolist()),
        classes=classes,
    )


def _mean(values: list[float | None]) -> float | None:
    """Average what is defined; None when nothing is."""
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else None
