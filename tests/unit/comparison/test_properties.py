"""What must hold for every comparison metric: perfect input is best, order means nothing, bounds hold."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from evaluator.comparison.summary import ComparisonMetrics, comparison_metrics
from evaluator.ground_truth import read_ground_truth
from evaluator.predictions import Predictions
from evaluator.synthetic import synthesize_ground_truth, write_zip
from tests.array_factories import Box, disturbed_boxes, make_ground_truth, make_predictions, scattered_boxes

LABELS = ("car", "truck", "bus", "train", "motorcycle", "bicycle")
IMAGES = 6

ERRORS = {"ate_m", "ase", "aoe_rad", "mate_m", "mase", "maoe_rad"}
"""Smaller is better, 0 is perfect."""
SCORES = {"ap", "ap_bev", "ap_3d", "ap_by_distance", "map", "nds3", "cds", "mcds", "let_ap", "let_apl"}
"""Greater is better, 1 is perfect."""
OTHERS = {"parameters", "label", "ground_truth_count", "min_iou", "lower_m", "upper_m"}


def numbers(value: Any, name: str = "") -> Iterator[tuple[str, float | None]]:
    """Yield every number with the name of its field."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from numbers(part, key)
    elif isinstance(value, (list, tuple)):
        for part in value:
            yield from numbers(part, name)
    else:
        yield name, value


def measured(comparison: ComparisonMetrics) -> list[tuple[str, float | None]]:
    """Return every metric by name; parameters and labels are left out, an unclassified name fails."""
    content = msgspec.to_builtins(comparison)
    del content["signature"]
    for benchmark in content.values():
        del benchmark["parameters"]
    found = list(numbers(content))
    assert {name for name, _ in found} <= ERRORS | SCORES | OTHERS
    return [(name, value) for name, value in found if name not in OTHERS]


def scene(seed: int) -> tuple[list[Box], list[Box]]:
    """Return ground truth and predictions of all classes."""
    truth = scattered_boxes(seed, images=IMAGES, per_image=16, labels=LABELS)
    return truth, disturbed_boxes(seed + 1, truth, images=IMAGES)


def compare(truth: list[Box], found: list[Box]) -> ComparisonMetrics:
    """Compute all comparison metrics."""
    return comparison_metrics(make_ground_truth(truth, images=IMAGES), make_predictions(found, images=IMAGES))


@pytest.mark.parametrize("seed", range(3))
def test_ground_truth_against_itself_is_perfect(seed: int) -> None:
    """Every defined error is 0 and every defined score 1."""
    truth, _ = scene(seed)
    for name, value in measured(compare(truth, truth)):
        assert value is None or value == pytest.approx(float(name in SCORES), abs=1e-12), name


def test_annotated_streets_against_themselves_are_perfect(tmp_path: Path) -> None:
    """So it is with boxes at any angle beside each other, which one metric moves along the line of sight."""
    write_zip(synthesize_ground_truth(500, seed=2), tmp_path / "gt.zip")
    truth = read_ground_truth(tmp_path / "gt.zip")
    shared = {field.name: getattr(truth, field.name) for field in fields(Predictions) if field.name != "score"}
    for name, value in measured(comparison_metrics(truth, Predictions(**shared, score=np.ones(len(truth))))):
        assert value is None or value == pytest.approx(float(name in SCORES), abs=1e-7), name


def test_a_single_box_against_itself_is_perfect() -> None:
    """No metric needs many boxes to reach its best."""
    values = measured(compare([Box()], [Box()]))
    defined = [(name, value) for name, value in values if value is not None]
    assert {name for name, _ in defined} == ERRORS | SCORES
    for name, value in defined:
        assert value == pytest.approx(float(name in SCORES), abs=1e-12), name


@pytest.mark.parametrize("seed", range(3))
def test_scores_stay_within_bounds(seed: int) -> None:
    """Scores are in [0, 1], errors at least 0."""
    for name, value in measured(compare(*scene(seed))):
        assert value is None or 0 <= value <= (1 if name in SCORES else 100), name


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_boxes_means_nothing(seed: int) -> None:
    """Shuffled boxes give the same numbers (scores are distinct)."""
    truth, found = scene(seed)
    rng = np.random.default_rng(seed)
    shuffled = [[boxes[i] for i in rng.permutation(len(boxes))] for boxes in (truth, found)]
    # a sum in another order may round differently
    assert [value for _, value in measured(compare(*shuffled))] == pytest.approx(
        [value for _, value in measured(compare(truth, found))], abs=1e-12
    )


def test_nothing_at_all_is_undefined() -> None:
    """Without boxes on either side every metric is None."""
    assert {value for _, value in measured(compare([], []))} == {None}


def test_a_false_positive_never_helps() -> None:
    """One more confident prediction of nothing raises no score."""
    truth, found = scene(0)
    worse = [*found, Box(label="car", center=(5.0, 30.0, 0.8), score=0.9995)]
    for (name, before), (_, after) in zip(
        measured(compare(truth, found)), measured(compare(truth, worse)), strict=True
    ):
        if name in SCORES and before is not None:
            assert after is not None
            assert after <= before + 1e-12, name


def test_scores_can_be_written_and_read_as_json() -> None:
    """A comparison survives JSON unchanged."""
    comparison = compare(*scene(1))
    assert msgspec.json.decode(msgspec.json.encode(comparison), type=ComparisonMetrics) == comparison
