"""The evaluator and the reference implementation on the same random cases: every number must agree."""

import json
import os
from pathlib import Path
from typing import Any

import msgspec

from evaluator.cityscapes_format import cityscapes_results
from evaluator.evaluation import evaluate
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions, read_predictions_leniently
from evaluator.matching import evaluated_labels
from evaluator.predictions import Predictions
from evaluator.protocol import CITYSCAPES3D
from tests.prediction_arrays import load_predictions
from tests.reference.process import reference_results, required_reference
from tests.reference.random_cases import write_case
from tests.results_comparison import differences

SEEDS = range(int(os.environ.get("CS3D_DIFFERENTIAL_SEEDS", "30")))
"""CI takes 30; by hand, `CS3D_DIFFERENTIAL_SEEDS=1000 pytest tests/integration/differential`."""


def our_results(case: dict[str, Any]) -> dict[str, Any]:
    """Evaluate a case, in the reference's format, by each way of reading its predictions."""
    parameters = case["parameters"]
    protocol = msgspec.structs.replace(
        CITYSCAPES3D,
        labels=tuple(parameters["labels"]),
        min_iou=parameters["min_iou"],
        max_depth_m=parameters["max_depth"],
        depth_step_m=parameters["step_size"],
        working_point=None if parameters["cw"] == -1 else parameters["cw"],
        modal=parameters["modal"],
        score_steps=parameters["num_conf"],
    )
    ground_truth = read_ground_truth(Path(case["gt"]))
    return {
        reading: json.loads(json.dumps(cityscapes_results(evaluate(ground_truth, predictions, protocol).scores)))
        for reading, predictions in readings(Path(case["pred"]), ground_truth, evaluated_labels(protocol)).items()
    }


def readings(folder: Path, ground_truth: GroundTruth, labels: tuple[str, ...]) -> dict[str, Predictions]:
    """Read a folder the plainest way, leniently, and strictly where it is accepted: an image may lack its file."""
    images = ground_truth.image_list()
    lenient = read_predictions_leniently(folder, images=images, labels=labels).predictions
    strict = read_predictions(folder, images=images, labels=labels).predictions
    assert lenient is not None
    plain = {"plain": load_predictions(folder, ground_truth.images, labels), "lenient": lenient}
    return plain if strict is None else {**plain, "strict": strict}


def test_random_cases_agree_with_the_reference_in_every_number(tmp_path: Path) -> None:
    """Boxes cut by the near plane, ties, scores on thresholds and every parameter give the reference's numbers."""
    python = required_reference()
    cases = [write_case(seed, tmp_path) for seed in SEEDS]

    expected = reference_results(cases, python)

    found = {
        f"seed {seed} {reading} {case['parameters']}": list(differences(ours, result))[:5]
        for seed, case, result in zip(SEEDS, cases, expected, strict=True)
        for reading, ours in our_results(case).items()
    }
    assert {place: places for place, places in found.items() if places} == {}
    assert any(" strict " in place for place in found)
