"""Every number of the diagnosis, classified by what changes it. A number nobody classified fails here.

Boxes are matched by their submitted modal boxes in these tests, detached from the 3D boxes, so that each property can
be disturbed by itself. A disturbance must change the numbers that list it, and no other.
"""

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from evaluator.diagnosis.diagnose import diagnose
from evaluator.diagnosis.errors import ERROR_NAMES
from evaluator.diagnosis.oracles import ORACLES
from evaluator.evaluation import evaluate
from evaluator.orientation import yaw_pitch_roll_rad
from evaluator.predictions import Predictions
from evaluator.protocol import CITYSCAPES3D
from tests.array_factories import annotated, disturbed_boxes, make_ground_truth, make_predictions, scattered_boxes
from tests.struct_numbers import Numbers, changed_fields, numbers_by_field

IMAGES = 6
MODAL = msgspec.structs.replace(CITYSCAPES3D, modal=True)
TRUTH = annotated(scattered_boxes(1, images=IMAGES, per_image=16, labels=("car", "truck")))
GROUND_TRUTH = make_ground_truth(TRUTH, images=IMAGES, ignore=[(0, (0.0, 300.0, 1000.0, 400.0))])


def turned(predictions: Predictions, angles_rad: np.ndarray) -> Predictions:
    """Add (N, 3) or (3,) yaw, pitch and roll of the protocol, R = Rx(roll) Ry(pitch) Rz(yaw), to every prediction's."""
    half = (yaw_pitch_roll_rad(predictions.rotation).T + angles_rad).T / 2
    (c, cy, cx), (s, sy, sx) = np.cos(half), np.sin(half)
    rotation = [
        cx * cy * c - sx * sy * s,
        sx * cy * c + cx * sy * s,
        cx * sy * c - sx * cy * s,
        sx * sy * c + cx * cy * s,
    ]
    return replace(predictions, rotation=np.column_stack(rotation))


def moved(predictions: Predictions, along_m: float, across_m: float, up_m: float) -> Predictions:
    """Move every prediction along and across its viewing ray; the cameras stand in the origin."""
    x, y = (predictions.center_m[:, :2] / np.linalg.norm(predictions.center_m[:, :2], axis=1)[:, None]).T
    offset = [along_m * x - across_m * y, along_m * y + across_m * x, np.full(len(x), up_m)]
    return replace(predictions, center_m=predictions.center_m + np.column_stack(offset))


def tilted_predictions() -> Predictions:
    """Return predictions with an error in everything."""
    found = make_predictions(annotated(disturbed_boxes(2, TRUTH, images=IMAGES, spread=0.4)), images=IMAGES)
    return turned(found, np.random.default_rng(3).normal(0, 0.05, (len(found), 3)))


def numbers(predictions: Predictions) -> Numbers:
    """Return every number of the diagnosis by its field; those of an oracle behind the oracle's name."""
    diagnosis = diagnose(evaluate(GROUND_TRUTH, predictions, MODAL))
    found = dict(numbers_by_field(msgspec.structs.replace(diagnosis, oracles=())))
    for oracle in diagnosis.oracles:
        found |= {f"{oracle.name}.{name}": values for name, values in numbers_by_field(oracle).items()}
    return found


PREDICTIONS = tilted_predictions()
BEFORE = numbers(PREDICTIONS)

DISTURBANCES: dict[str, Callable[[Predictions], Predictions]] = {
    "along the ray": lambda p: moved(p, 0.6, 0.0, 0.0),
    "across the ray": lambda p: moved(p, 0.0, 0.6, 0.0),
    "height above ground": lambda p: moved(p, 0.0, 0.0, 0.6),
    "yaw": lambda p: turned(p, np.array([0.2, 0.0, 0.0])),
    "pitch": lambda p: turned(p, np.array([0.0, 0.2, 0.0])),
    "roll": lambda p: turned(p, np.array([0.0, 0.0, 0.2])),
    "size": lambda p: replace(p, dimensions_m=p.dimensions_m * np.array([1.2, 0.9, 1.1])),
    "sign of the quaternion": lambda p: replace(p, rotation=-p.rotation),
    "length of the quaternion": lambda p: replace(p, rotation=3 * p.rotation),
    "amodal boxes": lambda p: replace(p, amodal_px=p.amodal_px + 10.0),
    "modal boxes": lambda p: replace(p, modal_px=p.modal_px * np.array([1.0, 1.0, 1.2, 1.2])),
    "order of scores": lambda p: replace(p, score=1 - p.score),
    "scores within their steps": lambda p: replace(p, score=(np.floor(p.score * 50) + p.score * 50 % 1 * 0.3) / 50),
    "other scores, many alike": lambda p: replace(p, score=np.floor((1 - p.score) * 4) / 4),
    "scores below 0": lambda p: replace(p, score=p.score - 0.3),
}
NEUTRAL = {"height above ground", "sign of the quaternion", "length of the quaternion", "amodal boxes"}
"""What changes no number of the diagnosis when boxes are matched by their modal boxes."""

SCORES = {"order of scores", "other scores, many alike"}
OUTCOMES = SCORES | {"modal boxes", "scores below 0"}
"""What changes which predictions and boxes are matched at the working point."""
WITHIN_STEPS = {"scores within their steps"}
PLACE = {"along the ray", "across the ray"}
TILT = {"pitch", "roll"}
BOXES = PLACE | TILT | {"yaw", "size"}
IN_BIN = OUTCOMES | {"along the ray"}
"""A false positive belongs to the depth bin it stands in itself."""

CHANGED_BY: dict[str, set[str]] = {
    "Errors.center_m": OUTCOMES | PLACE,
    "Errors.lateral_m": OUTCOMES | PLACE,  # the ray to the object is not quite the one to the prediction
    "Errors.longitudinal_m": OUTCOMES | PLACE,
    "Errors.depth_percent": OUTCOMES | PLACE,
    "Errors.yaw_deg": OUTCOMES | {"yaw"},
    "Errors.pitch_deg": OUTCOMES | {"pitch"},
    "Errors.roll_deg": OUTCOMES | {"roll"},
    "Errors.size_percent": OUTCOMES | {"size"},
    "ErrorSummary.true_positive_count": OUTCOMES,
    "Subset.found_count": OUTCOMES,
    "Subset.recall": OUTCOMES,
    "Causes.true_positive_count": OUTCOMES,
    "Causes.false_positive_count": OUTCOMES,
    "Causes.discarded_count": OUTCOMES,
    "Causes.missed_count": OUTCOMES,
    "Cause.count": OUTCOMES,
    "Cause.ap_gain": OUTCOMES,
    "Cause.detection_score_gain": OUTCOMES | BOXES,
    "Parts.ap": OUTCOMES | BOXES,
    "Parts.bevcd": OUTCOMES | PLACE,
    "Parts.yaw_sim": OUTCOMES | {"yaw"},
    "Parts.pr_sim": OUTCOMES | TILT,
    "Parts.size_sim": OUTCOMES | {"size"},
    "ReliabilityBin.count": OUTCOMES,
    "ReliabilityBin.mean_score": OUTCOMES | WITHIN_STEPS,
    "ReliabilityBin.precision": OUTCOMES,
    "Calibration.expected_calibration_error": OUTCOMES | WITHIN_STEPS,
    "DepthWorkingPoint.best_threshold": IN_BIN,
    "DepthWorkingPoint.best_precision_recall": IN_BIN,
    "DepthWorkingPoint.precision_recall": IN_BIN,
    "DepthWorkingPoint.loss": IN_BIN,
    "ScoreResolution.distinct_score_count": {"other scores, many alike"},
    "ScoreResolution.used_level_count": {"other scores, many alike", "scores below 0"},
    "ScoreResolution.never_active_count": {"scores below 0"},
    "ScoreResolution.fullest_level_share": {"other scores, many alike", "scores below 0"},
    "ScoreResolution.ap": OUTCOMES,
    "ScoreResolution.ap_all_scores": OUTCOMES,
}
"""A number -> the disturbances that change it."""

ORACLES_CHANGED_BY: dict[str, tuple[set[str], set[str]]] = {
    "perfect_position": (OUTCOMES | (BOXES - PLACE), OUTCOMES | PLACE),
    "perfect_yaw": (OUTCOMES | (BOXES - {"yaw"}), OUTCOMES | {"yaw"}),
    "perfect_pitch_roll": (OUTCOMES | (BOXES - TILT), OUTCOMES | TILT),
    "perfect_size": (OUTCOMES | (BOXES - {"size"}), OUTCOMES | {"size"}),
    "perfect_boxes": (OUTCOMES, OUTCOMES | BOXES),
    "no_false_positives": ((OUTCOMES - SCORES) | BOXES, OUTCOMES | BOXES),
    "no_misses": (OUTCOMES | BOXES, OUTCOMES | BOXES),
    "perfect_detection": ((OUTCOMES - SCORES) | BOXES, OUTCOMES | BOXES),
}
"""An oracle -> what changes its score, and what changes its gain. What an oracle makes perfect cannot change its score."""

for oracle, (score, gain) in ORACLES_CHANGED_BY.items():
    CHANGED_BY |= {f"{oracle}.Oracle.mds": score, f"{oracle}.OracleClass.detection_score": score}
    CHANGED_BY |= {f"{oracle}.Oracle.gain": gain, f"{oracle}.OracleClass.gain": gain}

NO_NUMBERS = {
    "name", "label", "lower", "upper", "lower_m", "upper_m", "ground_truth_count", "prediction_count", "level_count",
}  # fmt: skip
"""What depends on the ground truth, the protocol or the number of predictions alone."""
NO_RESULTS = {"Protocol", "Signature", "AnnotatorNoise"}
UNDEFINED_CLASS = {
    "ClassDiagnosis.accuracy",
    "ClassDiagnosis.causes",
    "ClassDiagnosis.loss",
    "ClassDiagnosis.calibration",
}


def test_every_number_of_the_diagnosis_is_classified() -> None:
    """A new number must be added to the tables above."""
    fields = {name: tuple(name.split(".")[-2:]) for name in BEFORE}
    numbers = {name for name, (struct, field) in fields.items() if struct not in NO_RESULTS and field not in NO_NUMBERS}

    assert numbers - UNDEFINED_CLASS == CHANGED_BY.keys()


def test_every_error_and_every_oracle_is_classified() -> None:
    """The tables name what the code has."""
    assert {f"Errors.{name}" for name in ERROR_NAMES} <= CHANGED_BY.keys()
    assert ORACLES_CHANGED_BY.keys() == ORACLES.keys()


def test_every_disturbance_is_classified() -> None:
    """It changes what lists it, or is neutral on purpose."""
    assert set().union(*CHANGED_BY.values()) == DISTURBANCES.keys() - NEUTRAL


@pytest.mark.parametrize("disturbance", DISTURBANCES)
def test_numbers_react_to_what_they_list_and_to_nothing_else(disturbance: str) -> None:
    """What changes one property changes the numbers that tell of it, and no other."""
    after = numbers(DISTURBANCES[disturbance](PREDICTIONS))

    expected = {name for name, what in CHANGED_BY.items() if disturbance in what}
    assert changed_fields(BEFORE, after, CHANGED_BY) == expected
