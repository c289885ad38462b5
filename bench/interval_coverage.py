"""How often a 95 % interval holds the truth, by simulation: where one is given, it should be 93 to 97 times in 100.

    python bench/interval_coverage.py [--data-sets=300] [--images=1525] [--protocol=cityscapes3d] [--without-depth-bins]
                                      [--frames=1] [--unit=image]

A synthetic benchmark of 4000 images plays the population, its scores are the truth. Each simulated data set draws
images from it; the intervals of three submissions and of their differences are computed as always and compared with the
truth. "62/81" means: of the data sets 81 % gave an interval, and 62 % of these intervals held the truth; "-" means that
none did. With `--frames=3` each image drawn stands for a sequence whose one to three frames are all alike, the worst case of
images that resemble each other; `--images` of these are drawn. Then intervals hold what they promise with `--unit=sequence`
only. The standard error of 95 % in N data sets is 22 / sqrt(N) percent points: 1.0 for 500.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench._population import POPULATION, populations, taken  # noqa: E402 - the path is set above
from evaluator.confidence import LEVEL, Interval  # noqa: E402 - likewise
from evaluator.interval_rules import FEWEST_BOXES_FOR_DIFFERENCE, sufficient  # noqa: E402 - likewise
from evaluator.predictions import Float64Array  # noqa: E402 - likewise
from evaluator.protocol import PROTOCOLS  # noqa: E402 - likewise
from evaluator.replicates import BIN_METRICS, METRICS, Replicates, replicate  # noqa: E402 - likewise
from evaluator.resampling import Unit  # noqa: E402 - likewise
from evaluator.statistics import Statistics  # noqa: E402 - likewise
from evaluator.uncertainty import (  # noqa: E402 - likewise
    Bootstrap,
    NamedIntervals,
    bootstrap,
    compare_replicates,
    named_intervals,
)

METHODS = {"good": (0, 8), "good, another draw": (0, 9), "middling": (1, 8)}
"""Which of `QUALITIES`, and the seed."""
PAIRS = {"two draws of one method": (0, 1), "good and middling": (0, 2)}
JUST_ENOUGH = {"ap": (20, 30), "yaw_sim": (400, 1000)}
JUST_ENOUGH_OTHERWISE = (30, 40)
"""From how many boxes to how many a depth bin has just enough of them: found ones, but for AP all there are."""

Hits = dict[tuple[str, str], Float64Array]
"""By table and row (N, K), for K metrics 1 for an interval that holds the truth, 0 for another, NaN for none."""


def main() -> None:
    """Simulate and print the coverage of each metric."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=300)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--protocol", choices=PROTOCOLS, default="cityscapes3d")
    parser.add_argument("--without-depth-bins", action="store_true", help="takes a fraction of the time")
    parser.add_argument("--frames", type=int, default=1, help="most frames of a sequence, all alike")
    parser.add_argument("--unit", choices=get_args(Unit), default="image", help="what intervals draw as a whole")
    args = parser.parse_args()
    by_depth = not args.without_depth_bins
    found = populations(METHODS.values(), PROTOCOLS[args.protocol])
    everything = np.ones((1, POPULATION), dtype=np.float32)
    truths = [replicate(population, everything, by_depth=by_depth) for population in found]
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(args.data_sets):
        drawn = rng.integers(0, POPULATION, args.images)
        frames = rng.integers(1, args.frames, args.images, endpoint=True) if args.frames > 1 else np.ones_like(drawn)
        parts = [taken(population, drawn, frames) for population in found]
        hits.append(_hits(parts, truths, unit=args.unit, by_depth=by_depth))
    print(f"{args.protocol}, coverage of 95 % intervals in percent, {args.data_sets} data sets of {args.images} images")
    if args.frames > 1:
        print(f"each image stands up to {args.frames} times, drawn as a whole for the intervals: {args.unit}")
    _print_tables({key: np.concatenate([of_one[key] for of_one in hits]) for key in hits[0]})


def _print_tables(hits: Hits) -> None:
    """Print a line for each row, below the name of its table."""
    for table in dict.fromkeys(table for table, _ in hits):
        _print(table, METRICS)
        for (own, row), values in hits.items():
            if own == table:
                _print(f"  {row}", [_share(column) for column in values.T])


def _print(name: str, cells: Sequence[str]) -> None:
    print(f"{name:26}" + "".join(f"{cell:>17}" for cell in cells), flush=True)


def _share(hits: Float64Array) -> str:
    """Say how many intervals held the truth, and how often there was one."""
    given = hits[~np.isnan(hits)]
    return f"{100 * given.mean():.1f}/{100 * len(given) / len(hits):.0f}" if len(given) else "-"


def _hits(parts: list[Statistics], truths: list[Replicates], *, unit: Unit, by_depth: bool) -> Hits:
    """Judge all intervals of one data set."""
    found = [bootstrap(part, unit=unit, by_depth=by_depth) for part in parts]
    hits: Hits = {}
    for name, part, own, truth in zip(METHODS, parts, found, truths, strict=True):
        hits |= _method_hits(name, part, own, truth)
    for name, pair in PAIRS.items():
        hits |= _difference_hits(name, [parts[i] for i in pair], [found[i] for i in pair], [truths[i] for i in pair])
    return hits


def _method_hits(name: str, statistics: Statistics, found: Bootstrap, truth: Replicates) -> Hits:
    """Judge the intervals of one submission."""
    means, classes, bins = named_intervals(statistics, found, LEVEL)
    hits = {(name, "mean"): _row(means, truth.means[0])[None]}
    for label, true in zip(statistics.labels, truth.classes[0], strict=True):
        hits[name, label] = _row(classes[label], true)[None]
    if found.estimate.depth_bins.size:
        cells = [cell for label in statistics.labels for cell in bins[label]]
        true_cells = truth.depth_bins[0].reshape(len(cells), -1)
        in_bins = np.array([_row(cell, true) for cell, true in zip(cells, true_cells, strict=True)])
        hits[name, "depth bins"] = in_bins
        hits[name, "just enough"] = np.where(_just_enough(statistics, found.estimate), in_bins, np.nan)
    return hits


def _just_enough(statistics: Statistics, estimate: Replicates) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Tell for (C * B, 5) metrics of depth bins whether they have just enough boxes for an interval."""
    grid = statistics.grid
    boxes = np.bincount(statistics.ground_truth_cell, minlength=grid[0] * grid[1]).reshape(grid)[:, :-1].ravel()
    found = estimate.true_positives[0].ravel()
    limits = [JUST_ENOUGH.get(metric, JUST_ENOUGH_OTHERWISE) for metric in BIN_METRICS]
    counts = [boxes if metric == "ap" else found for metric in BIN_METRICS]
    return np.array([(low <= own) & (own < high) for own, (low, high) in zip(counts, limits, strict=True)]).T


def _difference_hits(name: str, parts: list[Statistics], found: list[Bootstrap], truths: list[Replicates]) -> Hits:
    """Judge the differences of two submissions: of all means, and of the detection score of each class."""
    known = [sufficient(part, own.estimate, own.units) for part, own in zip(parts, found, strict=True)]
    boxes = np.bincount(parts[0].ground_truth_cell // parts[0].grid[1], minlength=parts[0].grid[0])
    is_score = np.array([metric == "detection_score" for metric in METRICS])
    enough = is_score & (boxes >= FEWEST_BOXES_FOR_DIFFERENCE)[:, None]
    given = np.vstack([known[0][0] & known[1][0], known[0][1] & known[1][1] & enough])
    estimate, truth = (_scores(one)[0] - _scores(other)[0] for one, other in ([own.estimate for own in found], truths))
    drawn = _scores(found[0].drawn) - _scores(found[1].drawn)
    hits = np.full(given.shape, np.nan)
    for row, column in np.argwhere(given).tolist():
        compared = compare_replicates(float(estimate[row, column]), drawn[:, row, column])
        hits[row, column] = _holds(None if compared is None else compared.difference, float(truth[row, column]))
    return {(name, label): row[None] for label, row in zip(("mean", *parts[0].labels), hits, strict=True)}


def _scores(found: Replicates) -> Float64Array:
    """Return (R, 1 + C, 6): the means, then the classes."""
    return np.concatenate([found.means[:, None], found.classes], axis=1)


def _row(intervals: NamedIntervals, truth: Float64Array) -> Float64Array:
    return np.array([_holds(own, true) for own, true in zip(intervals.values(), truth.tolist(), strict=True)])


def _holds(interval: Interval | None, truth: float) -> float:
    return float("nan") if interval is None else float(interval.lower <= truth <= interval.upper)


if __name__ == "__main__":
    main()
