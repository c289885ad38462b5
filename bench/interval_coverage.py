"""How often a 95 % interval holds the truth, by simulation: where one is given, it should be 93 to 97 times in 100.

    python bench/interval_coverage.py [--data-sets=300] [--images=1525] [--protocol=cityscapes3d]

A synthetic benchmark of 4000 images plays the population, its scores are the truth. Each simulated data set draws
images from it; its intervals are computed as always and compared with the truth. "62/81" means: of the data sets 81 %
gave an interval, and 62 % of these intervals held the truth; "-" means that none did.
"""

import argparse
import sys
import tempfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from evaluator.confidence import Interval  # noqa: E402 - the path is set above
from evaluator.evaluation import evaluate  # noqa: E402 - likewise
from evaluator.ground_truth import read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import read_predictions  # noqa: E402 - likewise
from evaluator.predictions import Float64Array, IndexArray  # noqa: E402 - likewise
from evaluator.protocol import PROTOCOLS, Protocol  # noqa: E402 - likewise
from evaluator.replicates import BIN_METRICS, MEANS, METRICS, replicate  # noqa: E402 - likewise
from evaluator.statistics import Statistics  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from evaluator.uncertainty import compare, intervals  # noqa: E402 - likewise

POPULATION = 4000
COMPARED = (0, 1)
"""Of `QUALITIES`: a good and a middling method, whose difference is judged, too."""


def main() -> None:
    """Simulate and print the coverage of each metric."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=300)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--protocol", choices=PROTOCOLS, default="cityscapes3d")
    args = parser.parse_args()
    first, second = _populations(PROTOCOLS[args.protocol])
    truths = _truth(first), _truth(second)
    labels = first.labels
    rng = np.random.default_rng(3)
    hits: list[Float64Array] = []
    for _ in range(args.data_sets):
        drawn = rng.integers(0, POPULATION, args.images)
        hits.append(_hits(taken(first, drawn), taken(second, drawn), truths))
    table = np.array(hits)
    print(f"{args.protocol}, coverage of 95 % intervals in percent, {args.data_sets} data sets of {args.images} images")
    _print("", METRICS)
    for index, name in enumerate(("mean", *labels)):
        _print(name, [_share(table[:, index * len(METRICS) + column]) for column in range(len(METRICS))])
    rest = table[:, (1 + len(labels)) * len(METRICS) :]
    in_bins = rest[:, : -len(MEANS)].reshape(-1, len(BIN_METRICS))
    _print("depth bins", [_share(in_bins[:, column]) for column in range(len(BIN_METRICS))])
    _print("difference", [_share(rest[:, column - len(MEANS)]) for column in range(len(MEANS))])


def _print(name: str, cells: tuple[str, ...] | list[str]) -> None:
    print(f"    {name:12}" + "".join(f"{cell:>17}" for cell in cells), flush=True)


def _share(hits: Float64Array) -> str:
    """Say how many intervals held the truth, and how often there was one."""
    given = hits[~np.isnan(hits)]
    return f"{100 * given.mean():.1f}/{100 * len(given) / len(hits):.0f}" if len(given) else "-"


def _hits(first: Statistics, second: Statistics, truths: tuple[Float64Array, Float64Array]) -> Float64Array:
    """Return 1 or 0 for each interval of one data set that holds the truth or not, NaN where none is given."""
    found = intervals(first)
    given: list[Interval | None] = [*found.means.values()]
    given += [interval for row in found.classes.values() for interval in row.values()]
    given += [interval for row in found.depth_bins.values() for part in row for interval in part.values()]
    own = [_holds(interval, truth) for interval, truth in zip(given, truths[0].tolist(), strict=True)]
    difference = (truths[0] - truths[1])[: len(MEANS)].tolist()
    compared = [None if part is None else part.difference for part in compare(first, second).values()]
    own += [_holds(interval, truth) for interval, truth in zip(compared, difference, strict=True)]
    return np.array(own, dtype=np.float64)


def _holds(interval: Interval | None, truth: float) -> float:
    return float("nan") if interval is None else float(interval.lower <= truth <= interval.upper)


def _truth(population: Statistics) -> Float64Array:
    """Return the population's scores: means, classes, depth bins."""
    found = replicate(population, np.ones((1, POPULATION), dtype=np.float32), by_depth=True)
    return np.concatenate([found.means.ravel(), found.classes.ravel(), found.depth_bins.ravel()])


def taken(statistics: Statistics, images: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Statistics:
    """Return the statistics of a data set that holds these images, each as often as it is named."""
    columns: dict[str, Any] = {}
    for side in ("ground_truth", "pair", "false_positive"):
        rows, image = _rows_of(getattr(statistics, f"{side}_image"), images)
        names = [field.name for field in fields(Statistics) if field.name.startswith(f"{side}_")]
        columns |= {name: getattr(statistics, name)[rows] for name in names}
        columns[f"{side}_image"] = image
    return replace(statistics, images=tuple(f"city_{index:06d}_000000" for index in range(len(images))), **columns)


def _rows_of(
    image_of_row: IndexArray, images: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> tuple[np.ndarray[Any, np.dtype[np.intp]], IndexArray]:
    """Return the rows of each of these images, one image after the other, and the place of their image."""
    order = np.argsort(image_of_row, kind="stable")
    start, stop = (np.searchsorted(image_of_row[order], images, side=side) for side in ("left", "right"))
    rows = [order[first:last] for first, last in zip(start, stop, strict=True)]
    return np.concatenate(rows), np.repeat(np.arange(len(images), dtype=np.int32), stop - start)


def _populations(protocol: Protocol) -> list[Statistics]:
    """Evaluate two methods on the population."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(POPULATION, seed=7)
        write_zip(files, folder / "gt.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        found = []
        for quality in COMPARED:
            write_zip(synthesize_predictions(files, QUALITIES[quality], 8, 20), folder / "predictions.zip")
            predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
            if predictions is None:
                raise SystemExit("the synthetic predictions are refused")
            found.append(evaluate(ground_truth, predictions, protocol).statistics)
    return found


if __name__ == "__main__":
    main()
