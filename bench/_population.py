"""A synthetic benchmark that plays the population, and data sets drawn from it: what simulations of coverage need."""

import tempfile
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.intake import read_predictions
from evaluator.predictions import IndexArray
from evaluator.protocol import Protocol
from evaluator.statistics import Statistics
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip

POPULATION = 4000
"""Images. Scores on all of them are the truth."""


def taken(statistics: Statistics, images: NDArray[np.int64], frames: NDArray[np.int64]) -> Statistics:
    """Return the statistics of a data set that holds a sequence for each of these images: so many frames, all like it."""
    image_names = [
        f"city_{number:06d}_{frame:06d}" for number, own in enumerate(frames.tolist()) for frame in range(own)
    ]
    images = np.repeat(images, frames)
    columns: dict[str, Any] = {}
    for side in ("ground_truth", "pair", "false_positive"):
        rows, image = _rows_of(getattr(statistics, f"{side}_image"), images)
        names = [field.name for field in fields(Statistics) if field.name.startswith(f"{side}_")]
        columns |= {name: getattr(statistics, name)[rows] for name in names}
        columns[f"{side}_image"] = image
    return replace(statistics, images=tuple(image_names), **columns)


def _rows_of(
    image_of_row: IndexArray, images: NDArray[np.int64]
) -> tuple[np.ndarray[Any, np.dtype[np.intp]], IndexArray]:
    """Return the rows of each of these images, one image after the other, and the place of their image."""
    order = np.argsort(image_of_row, kind="stable")
    start, stop = (np.searchsorted(image_of_row[order], images, side=side) for side in ("left", "right"))
    rows = [order[first:last] for first, last in zip(start, stop, strict=True)]
    return np.concatenate(rows), np.repeat(np.arange(len(images), dtype=np.int32), stop - start)


def populations(
    methods: Iterable[tuple[int, int]], protocol: Protocol, *, images: int = POPULATION
) -> list[Statistics]:
    """Evaluate methods, each one of `QUALITIES` and a seed, on the population."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(images, seed=7)
        write_zip(files, folder / "gt.zip")
        ground_truth = read_ground_truth(folder / "gt.zip")
        found = []
        for quality, seed in methods:
            write_zip(synthesize_predictions(files, QUALITIES[quality], seed, 20), folder / "predictions.zip")
            predictions = read_predictions(folder / "predictions.zip", images=ground_truth.image_list()).predictions
            if predictions is None:
                raise SystemExit("the synthetic predictions are refused")
            found.append(evaluate(ground_truth, predictions, protocol).statistics)
    return found
