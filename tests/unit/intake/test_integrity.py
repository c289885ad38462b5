from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from evaluator.evaluation import Evaluation, evaluate
from evaluator.fingerprint import fingerprint, similarity
from evaluator.ground_truth import read_ground_truth
from evaluator.intake import read_predictions
from evaluator.integrity import IntegrityAudit, audit
from evaluator.predictions import Predictions

ORACLE = Path(__file__).parents[2] / "data" / "oracle"


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    """The oracle's realistic case."""
    ground_truth = read_ground_truth(ORACLE / "realistic60" / "gt")
    predictions = read_predictions(ORACLE / "realistic60" / "pred", images=ground_truth.image_list()).predictions
    assert predictions is not None
    return evaluate(ground_truth, predictions)


def _again(evaluation: Evaluation, predictions: Predictions) -> Evaluation:
    return evaluate(evaluation.ground_truth, predictions)


def _hidden_in_ignore_regions(evaluation: Evaluation) -> Predictions:
    """Shrink each modal box to a pixel in the first ignore region of its image."""
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    modal_px = predictions.modal_px.copy()
    for image, (x, y, width, height) in zip(
        reversed(ground_truth.ignore_image_index), reversed(ground_truth.ignore_px), strict=True
    ):
        modal_px[predictions.image_index == image] = [x + width / 2, y + height / 2, 1.0, 1.0]
    return replace(predictions, modal_px=modal_px)


def test_honest_submission_is_not_held(evaluation: Evaluation) -> None:
    """The oracle's predictions, whose modal boxes are the projected ones, gain nothing by them."""
    result = audit(evaluation)
    assert result.modal_gap == pytest.approx(0.0, abs=1e-3)
    assert (result.held, result.reasons, result.duplicate_boxes, result.images_with_many_boxes) == (False, (), 0, 0)
    assert msgspec.json.decode(msgspec.json.encode(result), type=IntegrityAudit) == result


def test_modal_loophole_is_found(evaluation: Evaluation) -> None:
    """Placing the modal boxes in ignore regions raises the official mDS; the audit sees by how much and holds it."""
    cheat = _again(evaluation, _hidden_in_ignore_regions(evaluation))
    assert cheat.scores.mds is not None
    assert evaluation.scores.mds is not None
    gain = cheat.scores.mds - evaluation.scores.mds
    result = audit(cheat)
    assert gain > 0.05  # 0.61 -> 0.70 here
    assert result.modal_gap == pytest.approx(gain, abs=1e-3)
    assert result.held
    assert "modal" in result.reasons[0]


def test_lost_score_resolution_is_shown(evaluation: Evaluation) -> None:
    """The same ranking times 0.019 falls below every threshold but zero; spread evenly its AP is back."""
    squeezed = replace(evaluation.predictions, score=evaluation.predictions.score * 0.019)
    car = audit(_again(evaluation, squeezed)).score_resolution[0]
    assert (car.label, car.share_below_lowest_threshold) == ("car", 1.0)
    assert car.ap is not None
    assert car.ap_evenly_spread is not None
    assert car.ap_evenly_spread > car.ap + 0.3
    assert car.ap_evenly_spread == audit(evaluation).score_resolution[0].ap_evenly_spread  # only the ranking counts


def test_yaw_off_by_half_a_circle_is_seen(evaluation: Evaluation) -> None:
    """Every box turned round about its own vertical axis: (w, x, y, z) times (0, 0, 0, 1) is (-z, y, -x, w)."""
    turned = replace(evaluation.predictions, rotation=evaluation.predictions.rotation[:, [3, 2, 1, 0]] * [-1, 1, -1, 1])
    before = audit(evaluation).share_facing_backwards
    after = audit(_again(evaluation, turned)).share_facing_backwards
    assert before is not None
    assert before < 0.1
    assert after == pytest.approx(1 - before, abs=0.01)  # matching does not look at yaw


def test_no_match_faces_backwards_or_forwards(evaluation: Evaluation) -> None:
    """Without boxes there is nothing to say, which is neither 0 nor 1."""
    names = ("image_index", "label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    none = replace(evaluation.predictions, **{name: getattr(evaluation.predictions, name)[:0] for name in names})
    assert audit(_again(evaluation, none)).share_facing_backwards is None


def test_duplicates_are_counted(evaluation: Evaluation) -> None:
    """Each box twice: half of them are repetitions."""
    boxes = evaluation.predictions
    twice = np.repeat(np.arange(len(boxes)), 2)
    names = ("image_index", "label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    doubled = replace(boxes, **{name: getattr(boxes, name)[twice] for name in names})
    result = audit(_again(evaluation, doubled))
    assert result.duplicate_boxes == len(boxes)
    assert result.held


def test_no_boxes_at_all(evaluation: Evaluation) -> None:
    """An audit of nothing finds nothing."""
    nothing = np.zeros(0, dtype=bool)
    boxes = evaluation.predictions
    names = ("image_index", "label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    empty = replace(boxes, **{name: getattr(boxes, name)[: len(nothing)] for name in names})
    result = audit(_again(evaluation, empty))
    assert (result.held, result.fingerprint, result.most_boxes_in_image) == (False, "", 0)
    assert result.score_resolution[0].share_below_lowest_threshold is None


def test_copies_have_similar_fingerprints(evaluation: Evaluation) -> None:
    """A rescored copy with a centimetre of noise is recognised, another detector's boxes are not; order is no matter."""
    boxes = evaluation.predictions
    original = fingerprint(boxes)
    noise = np.random.default_rng(0).normal(0.0, 1.0, boxes.center_m.shape)
    copy = replace(boxes, center_m=boxes.center_m + 0.01 * noise, score=np.sqrt(boxes.score))
    other = replace(boxes, center_m=boxes.center_m * (1 + 0.02 * noise) + 0.2 * noise)
    assert similarity(original, original) == 1.0
    assert similarity(original, fingerprint(copy)) > 0.8
    assert similarity(original, fingerprint(other)) < 0.25
    assert similarity(original, "") == 0.0
    assert len(original) == 128 * 16
