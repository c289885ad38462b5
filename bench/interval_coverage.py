"""How often a 95 % interval holds the truth, by simulation: it should be 93 to 97 times in 100.

    python bench/interval_coverage.py [--data-sets=100] [--images=1525]

A synthetic benchmark of 4000 images plays the population, its scores are the truth. Each simulated data set draws
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
from evaluator.predictions import Float64Array  # noqa: E402 - likewise
from evaluator.replicates import METRICS, replicate  # noqa: E402 - likewise
from evaluator.resampling import WeightArray  # noqa: E402 - likewise
from evaluator.statistics import Statistics  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from evaluator.uncertainty import LEVEL, bca_bounds  # noqa: E402 - likewise

POPULATION, RESAMPLES = 4000, 300
TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


def main() -> None:
    """Simulate and print the coverage of each metric by both methods."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=100)
    parser.add_argument("--images", type=int, default=1525)
    args = parser.parse_args()
    statistics = _population()
    truth = _table(statistics, np.ones((1, POPULATION), dtype=np.float32))[0]
    rng = np.random.default_rng(3)
    hits = np.zeros((2, len(truth)))
    for _ in range(args.data_sets):
        hits += _covered(statistics, rng.integers(0, POPULATION, args.images), truth, rng)
    print(f"coverage of 95 % intervals in percent, {args.data_sets} data sets of {args.images} images")
    for method, counts in zip(("percentile", "bca"), hits, strict=True):
        print(f"  {method:21}" + "".join(f"{name:>17}" for name in METRICS))
        for name, row in zip(("mean", *statistics.labels), counts.reshape(-1, len(METRICS)), strict=True):
            print(f"    {name:19}" + "".join(f"{100 * value / args.data_sets:17.0f}" for value in row))


def _covered(
    statistics: Statistics,
    data: np.ndarray[tuple[int], np.dtype[np.int64]],
    truth: Float64Array,
    rng: np.random.Generator,
) -> Float64Array:
    """Return, for percentile and BCa intervals of one data set, which metrics they hold (1 or 0)."""
    size = len(data)
    drawn = data[rng.integers(0, size, (RESAMPLES, size))]
    resampled = _table(
        statistics, np.stack([np.bincount(row, minlength=POPULATION) for row in drawn]).astype(np.float32)
    )
    whole = np.bincount(data, minlength=POPULATION).astype(np.float32)
    left_out = np.repeat(whole[None], np.count_nonzero(whole), axis=0)
    left_out[np.arange(len(left_out)), np.flatnonzero(whole)] -= 1
    estimate, jackknife = _table(statistics, whole[None])[0], _table(statistics, left_out)
    lower, upper = np.nanquantile(resampled, TAILS, axis=0)
    bounds = [bca_bounds(estimate[i], resampled[:, i], jackknife[:, i], LEVEL) for i in range(len(truth))]
    by_bca = [bound is not None and bound[0] <= value <= bound[1] for bound, value in zip(bounds, truth, strict=True)]
    return np.array([(lower <= truth) & (truth <= upper), by_bca], dtype=np.float64)


def _population() -> Statistics:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(POPULATION, seed=7)
        write_zip(files, folder / "gt.zip")
        write_zip(synthesize_predictions(files, QUALITIES[0], 8, 20), folder / "predictions.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
        if predictions is None:
            raise SystemExit("the synthetic predictions are refused")
        return evaluate(ground_truth, predictions).statistics


def _table(statistics: Statistics, weights: WeightArray) -> Float64Array:
    found = replicate(statistics, weights)
    return np.concatenate([found.means[:, None], found.classes], axis=1).reshape(len(weights), -1)


if __name__ == "__main__":
    main()
