"""The measured effect of each difference between the protocols `cityscapes3d` and `paper`, one at a time.

    python bench/protocol_differences.py [--images=500]

Each line changes one thing of `cityscapes3d` into what `paper` does, on a synthetic benchmark with a good and a weak
method, and prints mDS and mAP with the change from the line above all.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from evaluator.evaluation import evaluate, signature_of  # noqa: E402 - the path is set above
from evaluator.ground_truth import GroundTruth, read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import read_predictions  # noqa: E402 - likewise
from evaluator.matching import match  # noqa: E402 - likewise
from evaluator.paper_matching import match_by_paper, projected_boxes  # noqa: E402 - likewise
from evaluator.paper_scoring import score_by_paper  # noqa: E402 - likewise
from evaluator.predictions import Float64Array, Predictions  # noqa: E402 - likewise
from evaluator.protocol import CITYSCAPES3D, PAPER  # noqa: E402 - likewise
from evaluator.results import Scores  # noqa: E402 - likewise
from evaluator.scoring import score  # noqa: E402 - likewise
from evaluator.statistics import Statistics, collect  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from evaluator.thresholds import MaskArray, has_threshold  # noqa: E402 - likewise
from evaluator.true_positive_metrics import mean_over_bins  # noqa: E402 - likewise


@dataclass(frozen=True)
class Summary:
    """The numbers shown of one variant."""

    mds: float
    map: float


Variant = Callable[[GroundTruth, Predictions], Summary]


def main() -> None:
    """Print one table for each method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=500)
    args = parser.parse_args()
    variants: dict[str, Variant] = {
        "cityscapes3d": lambda gt, p: _summary(evaluate(gt, p).scores),
        "ground-truth boxes projected, not annotated": _projected_ground_truth,
        "ignore regions tested with the projected box": _projected_ignore,
        "the paper's matching: score order, >= 0.7, no extra pixel, no clipping, union of regions": _paper_matching,
        "AP and c_w over all scores": _all_scores,
        "similarities as integrals over the whole range": _integrals,
        "paper": lambda gt, p: _summary(evaluate(gt, p, PAPER).scores),
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(args.images, seed=1)
        write_zip(files, folder / "gt.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        for quality in (QUALITIES[0], QUALITIES[-1]):
            write_zip(synthesize_predictions(files, quality, 2), folder / "predictions.zip")
            predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
            if predictions is None:
                raise SystemExit("the synthetic predictions are refused")
            _table(quality.title, variants, ground_truth, predictions)


def _table(title: str, variants: dict[str, Variant], ground_truth: GroundTruth, predictions: Predictions) -> None:
    print(
        f"\n{title}: {len(predictions)} predictions for {len(ground_truth)} boxes in {len(ground_truth.images)} images"
    )
    base: Summary | None = None
    for name, variant in variants.items():
        found = variant(ground_truth, predictions)
        base = base or found
        changes = f"{100 * (found.mds - base.mds):+6.2f} {100 * (found.map - base.map):+6.2f}"
        print(f"  {name:88} mDS {100 * found.mds:6.2f}  mAP {100 * found.map:6.2f}  {changes}")


def _summary(scores: Scores) -> Summary:
    return Summary(scores.mds or 0.0, scores.map or 0.0)


def _xywh(corners: Float64Array) -> Float64Array:
    x_min, y_min, x_max, y_max = np.clip(corners, 0, np.array([[2047.0], [1023.0], [2047.0], [1023.0]]))
    return np.stack([x_min, y_min, x_max - x_min, y_max - y_min], axis=1)


def _projected_ground_truth(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
    boxes = _xywh(projected_boxes(ground_truth, ground_truth))
    return _summary(evaluate(replace(ground_truth, amodal_px=boxes), predictions).scores)


def _projected_ignore(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
    boxes = _xywh(projected_boxes(ground_truth, predictions))
    return _summary(evaluate(ground_truth, replace(predictions, modal_px=boxes)).scores)


def _paper_matching(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
    matches = match_by_paper(ground_truth, predictions, CITYSCAPES3D)
    statistics = collect(ground_truth, predictions, matches, CITYSCAPES3D)
    return _summary(score(statistics, signature_of(CITYSCAPES3D, "", "")))


def _all_scores(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
    """Take the paper's AP and c_w, but average similarities over the filled bins."""
    scores = _scored_by_paper(ground_truth, predictions)
    ds = []
    for item in scores.classes:
        if item.ap is None:
            continue
        counts = np.array([depth.true_positive_count for depth in item.depth_bins])
        means = [
            [depth.bevcd or 0, depth.yaw_sim or 0, depth.pr_sim or 0, depth.size_sim or 0] for depth in item.depth_bins
        ]
        ds.append(item.ap * float(mean_over_bins(np.array(means) * counts[:, None], counts).mean()))
    return Summary(float(np.mean(ds)), scores.map or 0.0)


def _integrals(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
    """Take the reference's AP and c_w, but average similarities over all bins."""
    scores = evaluate(ground_truth, predictions).scores
    ds = []
    for item in scores.classes:
        if item.ap is not None:
            means = [
                [depth.bevcd or 0, depth.yaw_sim or 0, depth.pr_sim or 0, depth.size_sim or 0]
                for depth in item.depth_bins
            ]
            ds.append(item.ap * float(np.mean(means)))
    return Summary(float(np.mean(ds)), scores.map or 0.0)


def _scored_by_paper(ground_truth: GroundTruth, predictions: Predictions) -> Scores:
    """Aggregate the reference's matches by the paper's words.

    Thresholds change which pair the reference matches; here each prediction keeps the fate it has at its own score.
    """
    matches = match(ground_truth, predictions, CITYSCAPES3D)
    whole = collect(ground_truth, predictions, matches, CITYSCAPES3D)
    pairs = _at_own_score(whole.pair_masks, whole.pair_score, whole.thresholds)
    wrong = _at_own_score(whole.false_positive_masks, whole.false_positive_score, whole.thresholds)
    statistics = replace(
        whole,
        **{name: getattr(whole, name)[pairs] for name in Statistics.__slots__ if name.startswith("pair_")},
        **{name: getattr(whole, name)[wrong] for name in Statistics.__slots__ if name.startswith("false_")},
    )
    return score_by_paper(statistics, signature_of(CITYSCAPES3D, "", ""))


def _at_own_score(
    masks: MaskArray, scores: Float64Array, thresholds: Float64Array
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether each mask holds the highest threshold its prediction reaches."""
    reached = np.searchsorted(thresholds, scores, side="right") - 1
    return np.asarray(has_threshold(masks, np.maximum(reached, 0)) & (reached >= 0))


if __name__ == "__main__":
    main()
