"""Scores in the layout of the reference's `results.json`, with its keys and its conventions.

There an undefined class is all zeros, the means over no class are NaN, and keys of depth bins are strings.
Reference: `Box3dEvaluator.results`, `saveResults`.
"""

import math
from typing import Any

from evaluator.results import ClassScore, DepthBin, Scores

_METRICS = {"Center_Dist": "bevcd", "Size_Similarity": "size_sim", "OS_Yaw": "yaw_sim", "OS_Pitch_Roll": "pr_sim"}
"""The reference's names of the four similarities -> ours."""


def cityscapes_results(scores: Scores) -> dict[str, Any]:
    """Return everything the reference writes, key for key.

    `json.dumps` writes NaN as `NaN` and infinity never occurs, so the text equals the reference's, too.
    """
    classes = scores.classes
    results: dict[str, Any] = {
        "AP": {item.label: _average_precision(item, scores) for item in classes},
        "AP_per_depth": {item.label: _average_precision_per_depth(item) for item in classes},
    }
    for name, field in _METRICS.items():
        results[name] = {item.label: _true_positive_metric(item, field) for item in classes}
    results["GT_stats"] = {item.label: item.ground_truth_count for item in classes}
    results["working_confidence"] = {item.label: _working_point(item, scores) for item in classes}
    results["eval_params"] = _parameters(scores)
    results["Detection_Score"] = {item.label: item.detection_score or 0.0 for item in classes}
    return results | _means(scores)


def _means(scores: Scores) -> dict[str, float]:
    means = {
        "mDetection_Score": scores.mds,
        "mAP": scores.map,
        "mCenter_Dist": scores.mbevcd,
        "mSize_Similarity": scores.msize_sim,
        "mOS_Yaw": scores.myaw_sim,
        "mOS_Pitch_Roll": scores.mpr_sim,
    }
    return {name: math.nan if value is None else value for name, value in means.items()}


def _parameters(scores: Scores) -> dict[str, Any]:
    protocol = scores.signature.protocol
    return {
        "labels": list(protocol.labels),
        "min_iou_to_match": protocol.min_iou,
        "max_depth": protocol.max_depth_m,
        "step_size": protocol.depth_step_m,
        "matching_method": "Modal" if protocol.modal else "Amodal",
    }


def _average_precision(item: ClassScore, scores: Scores) -> dict[str, Any]:
    zeros = [0.0] * len(scores.thresholds)
    recall, precision = list(item.recall) or zeros, list(item.precision) or zeros
    return {"data": {"recall": recall, "precision": precision}, "auc": item.ap or 0.0}


def _average_precision_per_depth(item: ClassScore) -> dict[str, Any]:
    return {
        str(depth.lower_m): {
            "data": {"recall": list(depth.recall), "precision": list(depth.precision)},
            "auc": depth.ap,
        }
        for depth in item.depth_bins
        if depth.ground_truth_count
    }


def _true_positive_metric(item: ClassScore, field: str) -> dict[str, Any]:
    filled: list[DepthBin] = [depth for depth in item.depth_bins if depth.true_positive_count]
    return {
        "data": {str(depth.lower_m): getattr(depth, field) for depth in filled},
        "items": {str(depth.lower_m): depth.true_positive_count for depth in filled},
        "auc": getattr(item, field) or 0.0,
    }


def _working_point(item: ClassScore, scores: Scores) -> float:
    """Return c_w; a class without ground truth has the fixed one, or 0."""
    if item.working_point is not None:
        return item.working_point
    fixed = scores.signature.protocol.working_point
    if fixed is None:
        return 0.0
    return next(threshold for threshold in scores.thresholds if threshold >= min(max(fixed, 0.0), 1.0))
