"""The measured effect of each difference between the protocols `cityscapes3d` and `paper`, one at a time.

    python bench/protocol_differences.py [--images=500]

Each line changes one thing of `cityscapes3d` into what `paper` does, on a synthetic benchmark with a good and a weak
method, and prints mDS and mAP with the change from the first line.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol as Interface

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench._matching_rules import PAPER_RULES, Rules, match_by_rules  # noqa: E402 - the path is set above
from evaluator.comparison.boxes import camera_positions  # noqa: E402 - likewise
from evaluator.evaluation import evaluate, match_by_protocol, score_by_protocol, signature_of  # noqa: E402 - likewise
from evaluator.ground_truth import GroundTruth, read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import read_predictions  # noqa: E402 - likewise
from evaluator.matching import Matches, match  # noqa: E402 - likewise
from evaluator.paper_matching import match_by_paper  # noqa: E402 - likewise
from evaluator.paper_scoring import score_by_paper  # noqa: E402 - likewise
from evaluator.predictions import Float64Array, Predictions  # noqa: E402 - likewise
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol  # noqa: E402 - likewise
from evaluator.results import ClassScore, Scores  # noqa: E402 - likewise
from evaluator.scoring import score  # noqa: E402 - likewise
from evaluator.statistics import Statistics, collect  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from evaluator.thresholds import MaskArray, has_threshold  # noqa: E402 - likewise
from evaluator.true_positive_metrics import integral_over_range, mean_over_bins  # noqa: E402 - likewise

EQUAL = 1e-12


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
            _require_complete_rules(ground_truth, predictions)
            _table(quality.title, ground_truth, predictions)


def _table(title: str, ground_truth: GroundTruth, predictions: Predictions) -> None:
    print(
        f"\n{title}: {len(predictions)} predictions for {len(ground_truth)} boxes in {len(ground_truth.images)} images"
    )
    base: Summary | None = None
    for name, variant in VARIANTS.items():
        found = variant(ground_truth, predictions)
        base = base or found
        changes = f"{100 * (found.mds - base.mds):+z6.2f} {100 * (found.map - base.map):+z6.2f}"
        print(f"  {name:66} mDS {100 * found.mds:6.2f}  mAP {100 * found.map:6.2f}  {changes}")


def _require_complete_rules(ground_truth: GroundTruth, predictions: Predictions) -> None:
    """End unless the rules of either protocol, chosen one by one, give what its own matching gives."""
    for rules, own_matching in ((Rules(), match), (PAPER_RULES, match_by_paper)):
        expected = _matched(ground_truth, predictions, own_matching(ground_truth, predictions, CITYSCAPES3D))
        found = _by_rules(rules)(ground_truth, predictions)
        if max(abs(found.mds - expected.mds), abs(found.map - expected.map)) > EQUAL:
            raise SystemExit(f"{rules} give {found}, the evaluator {expected}: bench/_matching_rules.py misses a rule.")


def _summary(scores: Scores) -> Summary:
    return Summary(scores.mds or 0.0, scores.map or 0.0)


def _matched(ground_truth: GroundTruth, predictions: Predictions, matches: Matches) -> Summary:
    """Score matches as `cityscapes3d` does."""
    return _summary(score(collect(ground_truth, predictions, matches, signature_of(CITYSCAPES3D))))


def _by_rules(rules: Rules) -> Variant:
    """Match by these rules."""
    return lambda ground_truth, predictions: _matched(
        ground_truth, predictions, match_by_rules(ground_truth, predictions, rules)
    )


def _by_protocol(protocol: Protocol) -> Variant:
    return lambda ground_truth, predictions: _summary(evaluate(ground_truth, predictions, protocol).scores)


def _depth_from_camera(protocol: Protocol) -> Variant:
    """Measure depth on the ground plane from the camera instead of the rear axle."""

    def variant(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
        matches = match_by_protocol(ground_truth, predictions, protocol)
        camera_m = camera_positions(ground_truth.sensor_from_vehicle)
        moved = (  # differences of two centres, which BEVCD is about, stay what they are
            replace(ground_truth, center_m=ground_truth.center_m - camera_m[ground_truth.image_index]),
            replace(predictions, center_m=predictions.center_m - camera_m[predictions.image_index]),
        )
        return _summary(score_by_protocol(collect(*moved, matches, signature_of(protocol))))

    return variant


def _with_modal_boxes_in_regions(rules: Rules) -> Variant:
    """Write the first ignore region of the image into the modal box of every prediction, where there is one."""

    def variant(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
        regions = dict(zip(ground_truth.ignore_image_index[::-1].tolist(), ground_truth.ignore_px[::-1], strict=True))
        boxes = zip(predictions.image_index.tolist(), predictions.modal_px, strict=True)
        modal_px = np.array([regions.get(image, box) for image, box in boxes])
        return _by_rules(rules)(ground_truth, replace(predictions, modal_px=modal_px))

    return variant


class Averaging(Interface):
    """`mean_over_bins` or `integral_over_range`."""

    def __call__(self, sums: Float64Array, counts: Float64Array) -> Float64Array:
        """Average over depth bins."""


def _aggregated(
    *, all_scores_ap: bool = False, all_scores_c_w: bool = False, average: Averaging = mean_over_bins
) -> Variant:
    """Aggregate the reference's matches; AP and c_w may be the paper's, the average over depth as given."""

    def variant(ground_truth: GroundTruth, predictions: Predictions) -> Summary:
        on_grid = evaluate(ground_truth, predictions).scores
        at_all_scores = _scored_by_paper(ground_truth, predictions)
        of_ap, of_c_w = (at_all_scores if chosen else on_grid for chosen in (all_scores_ap, all_scores_c_w))
        ds = [
            first.ap * _mean_similarity(second, average)
            for first, second in zip(of_ap.classes, of_c_w.classes, strict=True)
            if first.ap is not None
        ]
        return Summary(float(np.mean(ds)), of_ap.map or 0.0)

    return variant


def _mean_similarity(item: ClassScore, average: Averaging) -> float:
    """Average the four similarities of a class over depth, and with each other."""
    counts = np.array([part.true_positive_count for part in item.depth_bins], dtype=np.float64)
    means = [[part.bevcd or 0, part.yaw_sim or 0, part.pr_sim or 0, part.size_sim or 0] for part in item.depth_bins]
    return float(average(np.array(means) * counts[:, None], counts).mean())


def _scored_by_paper(ground_truth: GroundTruth, predictions: Predictions) -> Scores:
    """Aggregate the reference's matches by the paper's words.

    Thresholds change which pair the reference matches; here each prediction keeps the fate it has at its own score.
    """
    matches = match(ground_truth, predictions, CITYSCAPES3D)
    whole = collect(ground_truth, predictions, matches, signature_of(CITYSCAPES3D))
    pairs = _at_own_score(whole.pair_masks, whole.pair_score, whole.thresholds)
    wrong = _at_own_score(whole.false_positive_masks, whole.false_positive_score, whole.thresholds)
    statistics = replace(
        whole,
        **{name: getattr(whole, name)[pairs] for name in Statistics.__slots__ if name.startswith("pair_")},
        **{name: getattr(whole, name)[wrong] for name in Statistics.__slots__ if name.startswith("false_")},
    )
    return score_by_paper(statistics)


def _at_own_score(
    masks: MaskArray, scores: Float64Array, thresholds: Float64Array
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether each mask holds the highest threshold its prediction reaches."""
    reached = np.searchsorted(thresholds, scores, side="right") - 1
    return np.asarray(has_threshold(masks, np.maximum(reached, 0)) & (reached >= 0))


VARIANTS: dict[str, Variant] = {
    "cityscapes3d": _by_protocol(CITYSCAPES3D),
    "1 order: greatest score first": _by_rules(Rules(by_score=True)),
    "2 overlap: plain widths, 0.7 or more": _by_rules(Rules(plain_overlap=True)),
    "3 ground-truth boxes projected, clipped like predictions": _by_rules(Rules(projects_ground_truth=True)),
    "4 predictions not clipped, ground truth as annotated": _by_rules(Rules(clips=False)),
    "3 and 4: both projected, neither clipped": _by_rules(Rules(projects_ground_truth=True, clips=False)),
    "5 ignore regions against the projected box": _by_rules(Rules(ignores_projected=True)),
    "6 ignore regions united": _by_rules(Rules(unites_regions=True)),
    "1 to 6: the paper's matching": _by_rules(PAPER_RULES),
    "7 AP over all scores": _aggregated(all_scores_ap=True),
    "8 c_w from all scores": _aggregated(all_scores_c_w=True),
    "9 similarities as integrals over the whole range": _aggregated(average=integral_over_range),
    "all of it: paper": _by_protocol(PAPER),
    "10 depth from the camera": _depth_from_camera(CITYSCAPES3D),
    "paper, with depth from the camera": _depth_from_camera(PAPER),
    "modal boxes put into ignore regions": _with_modal_boxes_in_regions(Rules()),
    "modal boxes put into ignore regions, and 5": _with_modal_boxes_in_regions(Rules(ignores_projected=True)),
}
"""Line of the table -> how to get it."""


if __name__ == "__main__":
    main()
