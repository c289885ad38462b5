"""How long the diagnosis and the comparison metrics take beside the evaluation itself, on one core.

    python bench/analysis_speed.py [--images=1525] [--boxes=30,100]

The workload is synthetic and seeded like that of evaluator_speed.py: about 13,000 ground-truth boxes. Best of three.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

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
from evaluator.synthetic import (
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)

GROUND_TRUTH_SEED, PREDICTION_SEED, RUNS = 1, 2, 3


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
    classes = class_boxes(predictions, ground_truth)
    return {
        "evaluate (match and score)": best_s(lambda: evaluate(ground_truth, predictions)),
        "diagnose": best_s(lambda: diagnose(evaluation)),
        "explain_difference": best_s(lambda: explain_difference(evaluation.scores, evaluation.scores)),
        "as KITTI": best_s(lambda: evaluate_kitti(classes)),
        "as nuScenes": best_s(lambda: evaluate_nuscenes(classes)),
        "as Waymo": best_s(lambda: evaluate_waymo(classes)),
        "as Argoverse 2": best_s(lambda: evaluate_argoverse(classes)),
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
            print(f"  {name:28} {seconds:8.3f} s")


if __name__ == "__main__":
    main()
