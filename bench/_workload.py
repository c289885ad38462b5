"""A synthetic benchmark on disk: ground truth and one submission of a given size."""

import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evaluator.protocol import EVALUATED_LABELS
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip

GROUND_TRUTH_SEED, PREDICTION_SEED, SPREAD_SEED, CLASS_SEED = 1, 2, 3, 5
OBJECTS_PER_IMAGE = 8
"""About as many as the ground truth has; predictions come with the likeliest first."""


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


def draw_classes_evenly(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Give all ground-truth boxes of evaluated classes a class drawn evenly."""
    rng = np.random.default_rng(CLASS_SEED)
    drawn = {}
    for name, data in files.items():
        document = json.loads(data)
        for box in document["objects"]:
            if box["label"] in EVALUATED_LABELS:
                box["label"] = str(rng.choice(EVALUATED_LABELS))
        drawn[name] = json.dumps(document).encode()
    return drawn


def spread_evenly(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Give all predictions scores drawn evenly from [0, 1], and those beyond the likely objects a class drawn evenly.

    So that in nearly every image every class has active predictions at nearly every threshold.
    """
    rng = np.random.default_rng(SPREAD_SEED)
    spread = {}
    for name, data in files.items():
        document = json.loads(data)
        for place, box in enumerate(document["objects"]):
            box["score"] = round(float(rng.random()), 6)
            if place >= OBJECTS_PER_IMAGE:
                box["label"] = str(rng.choice(EVALUATED_LABELS))
        spread[name] = json.dumps(document, separators=(",", ":")).encode()
    return spread
