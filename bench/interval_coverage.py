"""How often a 95 % interval holds the truth, by simulation: it should be 93 to 97 times in 100.

    python bench/interval_coverage.py [--data-sets=500] [--images=500]

A synthetic benchmark of 1525 images plays the population, its scores are the truth. Each simulated data set draws
images from it; intervals of that data set are computed as always and compared with the truth.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from evaluator.evaluation import evaluate  # noqa: E402 - the path is set above
from evaluator.ground_truth import read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import read_predictions  # noqa: E402 - likewise
from evaluator.replicates import MEANS, METRICS, replicate  # noqa: E402 - likewise
from evaluator.statistics import Statistics  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)

POPULATION, RESAMPLES = 1525, 400
SHOWN = ("car", "bicycle")
"""Classes with enough boxes in every simulated data set."""


def main() -> None:
    """Simulate and print the coverage of each metric."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=500)
    parser.add_argument("--images", type=int, default=500)
    args = parser.parse_args()
    statistics = _population()
    truth = _table(statistics, np.ones((1, POPULATION), dtype=np.float32))[0]
    rng = np.random.default_rng(11)
    hits = np.zeros(len(truth))
    for _ in range(args.data_sets):
        data = rng.integers(0, POPULATION, args.images)
        drawn = data[rng.integers(0, args.images, (RESAMPLES, args.images))]
        weights = np.stack([np.bincount(row, minlength=POPULATION) for row in drawn]).astype(np.float32)
        lower, upper = np.nanquantile(_table(statistics, weights), [0.025, 0.975], axis=0)
        hits += (lower <= truth) & (truth <= upper)
    coverage = (100 * hits / args.data_sets).reshape(-1, len(METRICS))
    print(f"coverage of 95 % percentile intervals, {args.data_sets} data sets of {args.images} images")
    names = ["mean (" + ", ".join(MEANS) + ")", *(f"{label} ({', '.join(METRICS)})" for label in SHOWN)]
    for name, row in zip(names, coverage[[0, *(1 + statistics.labels.index(label) for label in SHOWN)]], strict=True):
        print(f"  {name}: " + "  ".join(f"{value:.1f}" for value in row))


def _population() -> Statistics:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(POPULATION, seed=1)
        write_zip(files, folder / "gt.zip")
        write_zip(synthesize_predictions(files, QUALITIES[0], 2, 30), folder / "predictions.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
        if predictions is None:
            raise SystemExit("the synthetic predictions are refused")
        return evaluate(ground_truth, predictions).statistics


def _table(
    statistics: Statistics, weights: np.ndarray[tuple[int, ...], np.dtype[np.float32]]
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    found = replicate(statistics, weights)
    return np.concatenate([found.means[:, None], found.classes], axis=1).reshape(len(weights), -1)


if __name__ == "__main__":
    main()
