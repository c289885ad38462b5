from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.codes import Code
from evaluator.doctor import examine
from evaluator.findings import Findings
from evaluator.ground_truth import ImageList, read_ground_truth
from evaluator.intake import read_predictions
from evaluator.predictions import Predictions
from evaluator.protocol import VEHICLE_LABELS
from evaluator.report import ProblemGroup
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions
from tests.data.corpus_predictions import IMAGE, box, document
from tests.data.mistakes import MISTAKES, about_z, multiply, noisy

ORACLE = Path(__file__).parents[2] / "data" / "oracle"
CASES = sorted(path.name for path in ORACLE.iterdir())


def _oracle(case: str) -> tuple[Predictions, ImageList]:
    images = read_ground_truth(ORACLE / case / "gt").image_list()
    predictions = read_predictions(ORACLE / case / "pred", images=images).predictions
    assert predictions is not None
    return predictions, images


def _warnings(predictions: Predictions, images: ImageList | None) -> tuple[ProblemGroup, ...]:
    findings = Findings()
    examine(predictions, images=images, known_labels=frozenset(VEHICLE_LABELS), findings=findings)
    return findings.report(images_expected=0, images_found=0, boxes=0).groups


def _codes(predictions: Predictions, images: ImageList | None) -> set[str]:
    return {group.code for group in _warnings(predictions, images)}


@pytest.mark.parametrize("case", ["realistic60", "modal_iou50"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_recognised(case: str, mistake: str) -> None:
    """Each mistake made on the oracle's predictions is recognised, with confidence, and none is taken for another."""
    expected, make = MISTAKES[mistake]
    predictions, images = _oracle(case)
    groups = _warnings(make(predictions, images), images)
    found = {group.code for group in groups}
    # boxes of other objects are outside of nothing in particular: their modal boxes moved along with them
    assert found == expected
    assert all(group.severity == "warning" for group in groups)
    assert all(group.confidence is not None and group.confidence >= 0.5 for group in groups)


@pytest.mark.parametrize("case", CASES)
def test_clean_predictions_raise_no_alarm(case: str) -> None:
    """None of the oracle's predictions is suspected of anything."""
    predictions, images = _oracle(case)
    assert _codes(predictions, images) == set()


@pytest.mark.parametrize("strength", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("case", ["realistic60", "modal_iou50", "scores_on_thresholds"])
def test_noisy_predictions_raise_no_alarm(case: str, seed: int, strength: float) -> None:
    """Bad boxes are not a mistake of convention."""
    predictions, images = _oracle(case)
    assert _codes(noisy(predictions, seed, strength), images) == set()


def test_vehicles_facing_backwards_are_noticed() -> None:
    """Where traffic runs in one direction, as on a real road, a yaw off by 180 degrees turns it against the camera.

    From predictions and cameras alone nothing else tells: a box looks the same from its front and its back.
    """
    predictions, images = _oracle("realistic60")
    forwards = replace(predictions, rotation=np.tile([1.0, 0, 0, 0], (len(predictions), 1)))
    backwards = replace(predictions, rotation=np.tile([0.0, 0, 0, 1], (len(predictions), 1)))
    assert Code.YAW_OFF_BY_180 not in _codes(forwards, images)
    assert Code.YAW_OFF_BY_180 in _codes(backwards, images)


@pytest.mark.parametrize("case", ["realistic60", "modal_iou50"])
def test_boxes_turned_around_are_not_noticed_without_traffic(case: str) -> None:
    """Where headings point everywhere, as on an imaginary road, a yaw off by 180 degrees cannot be told: the limit."""
    predictions, images = _oracle(case)
    half_circle = about_z(np.full(len(predictions), np.pi))
    turned = replace(predictions, rotation=multiply(predictions.rotation, half_circle))
    assert _codes(turned, images) == set()


def test_few_boxes_prove_nothing() -> None:
    """With fewer than twenty boxes nothing is concluded about geometry."""
    predictions, images = _oracle("tiny_by_hand")
    assert len(predictions) < 20
    assert _codes(replace(predictions, rotation=predictions.rotation[:, [1, 2, 3, 0]]), images) == set()


@pytest.mark.parametrize("seed", [1, 18])
def test_forty_sound_boxes_raise_no_alarm(seed: int, tmp_path: Path) -> None:
    """Draws with hardly a vehicle nearby: the road tells nothing there, and the 2D boxes fit as they are."""
    files = synthesize_ground_truth(60, 1)
    for folder, content in (("gt", files), ("pred", synthesize_predictions(files, QUALITIES[1], 1, None))):
        (tmp_path / folder).mkdir()
        for name, data in content.items():
            (tmp_path / folder / name).write_bytes(data)
    images = read_ground_truth(tmp_path / "gt").image_list()
    predictions = read_predictions(tmp_path / "pred", images=images).predictions
    assert predictions is not None
    drawn = np.sort(np.random.default_rng(seed).choice(len(predictions), 40, replace=False))
    names = [field.name for field in fields(predictions) if field.name not in {"images", "labels"}]
    columns: dict[str, Any] = {name: getattr(predictions, name)[drawn] for name in names}
    assert _codes(replace(predictions, **columns), images) == set()


@pytest.mark.parametrize("mistake", ["xyzw", "w_l_h", "corners", "angles_in_degrees"])
def test_some_mistakes_need_no_camera(mistake: str) -> None:
    """Without cameras, what shows in the boxes themselves is still recognised."""
    expected, make = MISTAKES[mistake]
    predictions, images = _oracle("realistic60")
    assert _codes(make(predictions, images), None) >= expected


def test_two_mistakes_are_both_recognised() -> None:
    """One mistake does not hide another."""
    predictions, images = _oracle("realistic60")
    both = MISTAKES["w_l_h"][1](MISTAKES["xyzw"][1](predictions, images), images)
    assert _codes(both, images) == {"quaternion_xyzw", "dimensions_order"}


@pytest.mark.parametrize(
    ("label", "code"),
    [
        ('"Car"', "labels_capitalised"),
        ('"Cars"', "labels_capitalised"),
        ('"26"', "labels_numeric"),
        ("26", "labels_numeric"),
    ],
)
def test_spelling_of_labels_is_recognised(label: str, code: str, tmp_path: Path) -> None:
    """Capitalised and numeric labels are refused and explained."""
    (tmp_path / f"{IMAGE}_pred.json").write_bytes(document(box(label=label)))
    report = read_predictions(tmp_path, images=None).report
    assert not report.accepted
    assert code in {group.code for group in report.groups}


def test_odd_labels_are_not_explained() -> None:
    """A label that is no class in any spelling gives no hint."""
    assert _codes(_oracle("tiny_by_hand")[0], None) == set()


def test_no_boxes_at_all(tmp_path: Path) -> None:
    """A submission without any box is valid, and a warning asks whether that is meant; one box more takes it away."""
    file = tmp_path / f"{IMAGE}_pred.json"
    file.write_bytes(document())
    report = read_predictions(tmp_path, images=None).report
    assert report.accepted
    assert [(group.code, group.severity) for group in report.groups] == [("no_boxes", "warning")]
    file.write_bytes(document(box()))
    assert read_predictions(tmp_path, images=None).report.groups == ()
