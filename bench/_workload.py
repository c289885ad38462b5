"""A synthetic benchmark on disk: ground truth and one submission of a given size."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip

GROUND_TRUTH_SEED, PREDICTION_SEED = 1, 2


@dataclass(frozen=True, slots=True)
class Workload:
    """Where the files are."""

    folder: Path
    ground_truth: Path
    """A folder or zip named `gt`, where an installation looks for it."""
    predictions: Path


@contextmanager
def workload(images: int, boxes: int) -> Iterator[Workload]:
    """Make the files for `images` images with `boxes` predicted boxes each."""
    with tempfile.TemporaryDirectory(prefix="cs3d-bench-") as name:
        folder = Path(name)
        files = synthesize_ground_truth(images, GROUND_TRUTH_SEED)
        write_zip(files, folder / "gt")
        write_zip(synthesize_predictions(files, QUALITIES[0], PREDICTION_SEED, boxes), folder / "pred.zip")
        yield Workload(folder, folder / "gt", folder / "pred.zip")
