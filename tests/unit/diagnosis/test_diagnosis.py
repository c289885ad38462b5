"""The whole diagnosis: consistent with the scores, perfect for perfect input, indifferent to order, plain JSON."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from evaluator.diagnosis.causes import FALSE_POSITIVE_CAUSES, sort_by_cause
from evaluator.diagnosis.diagnose import Diagnosis, diagnose
from evaluator.diagnosis.nearest import nearest
from evaluator.diagnosis.working_point import at_working_point
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol
from tests.array_factories import (
    Box,
    annotated,
    disturbed_boxes,
    make_ground_truth,
    make_predictions,
    scattered_boxes,
)

IMAGES = 10
LABELS = ("car", "truck", "bicycle")
TRUTH = annotated(scattered_boxes(1, images=IMAGES, per_image=12, labels=LABELS))
FOUND = annotated(disturbed_boxes(2, TRUTH, images=IMAGES, spread=0.4))
IGNORE = [(image, (0.0, 300.0, 1000.0, 400.0)) for image in range(0, IMAGES, 2)]


def evaluation_of(truth: list[Box], found: list[Box], protocol: Protocol = CITYSCAPES3D) -> Evaluation:
    """Evaluate a scene with ignore regions."""
    ground_truth = make_ground_truth(truth, images=IMAGES, ignore=IGNORE)
    return evaluate(ground_truth, make_predictions(found, images=IMAGES), protocol)


def leaves(value: Any) -> Iterator[Any]:
    """Yield every plain value of a JSON tree."""
    if isinstance(value, (dict, list, tuple)):
        for part in value.values() if isinstance(value, dict) else value:
            yield from leaves(part)
    else:
        yield value


@pytest.mark.parametrize("modal", [False, True])
def test_causes_account_for_every_prediction_and_box(modal: bool) -> None:  # noqa: FBT001 - a parameter of the test
    """Counts agree with the scores' own counts at the working point, and causes with the false positives."""
    evaluation = evaluation_of(TRUTH, FOUND, msgspec.structs.replace(CITYSCAPES3D, modal=modal))
    for score, explained in zip(evaluation.scores.classes, diagnose(evaluation).classes, strict=True):
        if explained.causes is None:
            assert score.ground_truth_count == 0
            continue
        found = explained.causes
        assert found.true_positive_count + found.missed_count == found.ground_truth_count == score.ground_truth_count
        assert sum(cause.count for cause in found.causes[:-1]) == found.false_positive_count
        assert found.causes[-1].count <= found.missed_count
        assert all(cause.ap_gain is not None and cause.ap_gain >= -1e-12 for cause in found.causes)
        index = evaluation.scores.thresholds.index(score.working_point)
        assert score.recall[index] == pytest.approx(found.true_positive_count / found.ground_truth_count)
        counted = found.true_positive_count + found.false_positive_count
        assert score.precision[index] == pytest.approx(found.true_positive_count / counted)


def test_nearest_boxes_agree_with_the_matching() -> None:
    """Every true positive overlaps a box of its class enough; every free box is overlapped by no false positive."""
    evaluation = evaluation_of(TRUTH, FOUND)
    point, near = at_working_point(evaluation), nearest(evaluation)
    assert (near.own_iou[point.pair_prediction] > 0.7).all()
    duplicates = np.flatnonzero(point.false_positive & (near.own_iou > 0.7))
    assert len(duplicates) > 0
    assert point.found[near.own_row[duplicates]].all()


@pytest.mark.parametrize("seed", range(3))
def test_perfect_predictions_leave_nothing_to_explain(seed: int) -> None:
    """Ground truth against itself: no errors, no causes, no loss, no gains."""
    truth = annotated(scattered_boxes(seed, images=IMAGES, per_image=12, labels=LABELS))
    diagnosis = diagnose(evaluation_of(truth, truth))
    mean = msgspec.structs.astuple(diagnosis.accuracy.errors.mean)
    assert mean == pytest.approx((0,) * len(mean), abs=1e-9)
    assert {subset.recall for part in diagnosis.accuracy.groupings for subset in part.subsets} == {1.0}
    for part in diagnosis.classes:
        if part.causes is not None and part.loss is not None:
            assert {cause.count for cause in part.causes.causes} == {0}
            assert part.loss.total() == pytest.approx(0.0, abs=1e-12)
    assert [oracle.gain for oracle in diagnosis.oracles] == pytest.approx([0.0] * len(diagnosis.oracles), abs=1e-12)


def test_the_order_of_boxes_means_nothing() -> None:
    """Shuffled boxes give the same diagnosis, up to the rounding of sums."""
    rng = np.random.default_rng(0)
    shuffled = [[boxes[i] for i in rng.permutation(len(boxes))] for boxes in (TRUTH, FOUND)]
    ours, theirs = (
        list(leaves(msgspec.to_builtins(diagnose(evaluation_of(*pair))))) for pair in ((TRUTH, FOUND), shuffled)
    )
    for one, other in zip(ours, theirs, strict=True):
        assert one == (pytest.approx(other, abs=1e-9) if isinstance(other, float) else other)


def test_a_diagnosis_is_plain_json_without_nan() -> None:
    """It survives JSON unchanged, and every number is finite."""
    diagnosis = diagnose(evaluation_of(TRUTH, FOUND))
    assert msgspec.json.decode(msgspec.json.encode(diagnosis), type=Diagnosis) == diagnosis
    numbers = [leaf for leaf in leaves(msgspec.to_builtins(diagnosis)) if isinstance(leaf, float)]
    assert all(math.isfinite(number) for number in numbers)


@pytest.mark.parametrize(("truth", "found"), [([], []), ([], FOUND), (TRUTH, [])])
def test_empty_sides_are_explained_too(truth: list[Box], found: list[Box]) -> None:
    """Without predictions errors are undefined; without ground truth the classes are."""
    diagnosis = diagnose(evaluation_of(truth, found))
    assert diagnosis.accuracy.errors.mean.center_m is None
    defined = {part.label for part in diagnosis.classes if part.causes is not None}
    assert defined == {box.label for box in truth}


def test_classes_without_ground_truth_are_undefined() -> None:
    """Buses are in no image: nothing about them is explained."""
    bus = next(part for part in diagnose(evaluation_of(TRUTH, FOUND)).classes if part.label == "bus")
    assert (bus.accuracy, bus.causes, bus.loss, bus.calibration) == (None, None, None, None)


@pytest.mark.parametrize("cause", ["both", "background"])
def test_gains_are_what_a_submission_without_those_predictions_scores(cause: str) -> None:
    """Predictions of these causes match nothing at any threshold, so they can be left out and evaluated again."""
    evaluation = evaluation_of(TRUTH, FOUND)
    by_cause = sort_by_cause(nearest(evaluation), 0.7).cause == FALSE_POSITIVE_CAUSES.index(cause)
    discarded_somewhere = evaluation.matches.ignored_thresholds > 0
    in_order = sorted(FOUND, key=lambda box: box.image)
    kept = [box for box, gone in zip(in_order, by_cause & ~discarded_somewhere, strict=True) if not gone]
    assert len(kept) < len(FOUND)
    repaired = evaluation_of(TRUTH, kept)
    for before, after, part in zip(
        evaluation.scores.classes, repaired.scores.classes, diagnose(evaluation).classes, strict=True
    ):
        if part.causes is not None and before.ap is not None and after.ap is not None:
            gain = next(item.ap_gain for item in part.causes.causes if item.name == cause)
            assert gain is not None
            assert before.ap + gain == pytest.approx(after.ap, abs=1e-12)


def test_no_misses_is_what_the_ground_truth_without_them_gives() -> None:
    """Boxes that no threshold finds take part in nothing, so they can be left out and evaluated again."""
    evaluation = evaluation_of(TRUTH, FOUND)
    in_order = sorted(TRUTH, key=lambda box: box.image)
    found = [box for box, mask in zip(in_order, evaluation.matches.matched_thresholds, strict=True) if mask]
    assert len(found) < len(TRUTH)
    oracle = next(oracle for oracle in diagnose(evaluation).oracles if oracle.name == "no_misses")
    assert oracle.mds == pytest.approx(evaluation_of(found, FOUND).scores.mds, abs=1e-12)


def test_the_protocol_paper_is_refused() -> None:
    """Its thresholds are all scores, so there are no sets of thresholds to look at."""
    with pytest.raises(UsageError, match="cityscapes3d"):
        diagnose(evaluation_of(TRUTH, FOUND, PAPER))
