"""How long uncertainty, diagnosis and the comparison metrics take beside the evaluation itself, on one core.

    python bench/analysis_speed.py [--images=1525] [--boxes=30,100]

The workload is synthetic and seeded like that of evaluator_speed.py: about 13,000 ground-truth boxes. Best of three.
The leaderboard is of 100 methods, each with 1000 replicates of mDS.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from evaluator.comparison.argoverse import evaluate_argoverse
from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.kitti import evaluate_kitti
from evaluator.comparison.nuscenes import evaluate_nuscenes
from evaluator.comparison.waymo import evaluate_waymo
from evaluator.diagnosis.diagnose import diagnose
from evaluator.diagnosis.difference import explain_difference
from evaluator.evaluation import evaluate
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions
from evaluator.predictions import Predictions
from evaluator.protocol import PAPER
from evaluator.score_replicates import score_replicates
from evaluator.standings import Standings
from evaluator.synthetic import (
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from evaluator.uncertainty import RESAMPLES, compare, intervals, mds_replicates

GROUND_TRUTH_SEED, PREDICTION_SEED, RUNS = 1, 2, 3
METHODS = 100


def best_s(work: Callable[[], object]) -> float:
    """Return the shortest time of several runs."""
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def workload(images: int, boxes: int) -> tuple[GroundTruth, Predictions]:
    """Make one workload."""
    files = synthesize_ground_truth(images, GROUND_TRUTH_SEED)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_zip(files, folder / "gt.zip")
        write_zip(synthesize_predictions(files, QUALITIES[0], PREDICTION_SEED, boxes), folder / "predictions.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
    if predictions is None:
        raise SystemExit("the synthetic predictions are refused")
    return ground_truth, predictions


def measure(ground_truth: GroundTruth, predictions: Predictions) -> dict[str, float]:
    """Time everything on one workload."""
    evaluation = evaluate(ground_truth, predictions)
    statistics, by_paper = evaluation.statistics, evaluate(ground_truth, predictions, PAPER).statistics
    classes = class_boxes(predictions, ground_truth)
    return {
        "evaluate (match and score)": best_s(lambda: evaluate(ground_truth, predictions)),
        "1000 resamples, all means and classes": best_s(lambda: mds_replicates(statistics)),
        "intervals of all metrics, percentile": best_s(lambda: intervals(statistics, method="percentile")),
        "intervals of all metrics, BCa": best_s(lambda: intervals(statistics)),
        "  without depth bins": best_s(lambda: intervals(statistics, by_depth=False)),
        "intervals, protocol paper, BCa": best_s(lambda: intervals(by_paper, by_depth=False)),
        "paired comparison of two": best_s(lambda: compare(statistics, statistics)),
        "what a leaderboard keeps": best_s(lambda: score_replicates(statistics).to_bytes()),
        **leaderboard(),
        "diagnose": best_s(lambda: diagnose(evaluation)),
        "explain_difference": best_s(lambda: explain_difference(evaluation.scores, evaluation.scores)),
        "as KITTI": best_s(lambda: evaluate_kitti(classes)),
        "as nuScenes": best_s(lambda: evaluate_nuscenes(classes)),
        "as Waymo": best_s(lambda: evaluate_waymo(classes)),
        "as Argoverse 2": best_s(lambda: evaluate_argoverse(classes)),
    }


def leaderboard() -> dict[str, float]:
    """Time the ranks of 100 methods: all at once, and one more."""
    rng = np.random.default_rng(GROUND_TRUTH_SEED)
    mds = np.sort(rng.uniform(0.2, 0.7, METHODS))[::-1, None] + rng.normal(0, 0.02, (METHODS, RESAMPLES))
    standings = Standings.of(mds)
    order = np.argsort(-mds.mean(axis=1)).tolist()
    return {
        f"ranks of {METHODS} methods": best_s(lambda: Standings.of(mds).rank_intervals()),
        "  one method added to them": best_s(lambda: standings.adding(mds[0])),
        "  their groups": best_s(lambda: standings.groups(order)),
    }


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--boxes", type=lambda text: [int(part) for part in text.split(",")], default=[30, 100])
    arguments = parser.parse_args()
    for boxes in arguments.boxes:
        ground_truth, predictions = workload(arguments.images, boxes)
        print(f"{arguments.images} images, {len(ground_truth)} ground-truth boxes, {len(predictions)} predictions")
        for name, seconds in measure(ground_truth, predictions).items():
            print(f"  {name:40} {seconds:8.4f} s")


if __name__ == "__main__":
    main()
