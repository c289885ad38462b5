"""The protocol `cityscapes3d` against recorded results of the reference implementation."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from evaluator.cityscapes_format import cityscapes_results
from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.protocol import CITYSCAPES3D, Protocol
from tests.prediction_arrays import load_predictions
from tests.results_comparison import differences

ROOT = Path(__file__).parents[3]
RECORDED = sorted((ROOT / "tests" / "data" / "oracle").iterdir())
SHARED = sorted(path.parent for path in (ROOT.parent / "shared" / "oracle").glob("*/params.json"))


def _protocol(parameters: dict[str, Any]) -> Protocol:
    return msgspec.structs.replace(
        CITYSCAPES3D,
        labels=tuple(parameters["labels"]),
        min_iou=parameters["min_iou"],
        max_depth_m=parameters["max_depth"],
        depth_step_m=parameters["step_size"],
        score_steps=parameters["num_conf"],
        working_point=None if parameters["cw"] == -1 else parameters["cw"],
        modal=parameters["modal"],
    )


@pytest.mark.parametrize("case", RECORDED + SHARED, ids=lambda case: f"{case.parent.parent.name}-{case.name}")
def test_every_number_of_every_recorded_case_is_reproduced(case: Path) -> None:
    """The complete results document of the reference comes out, keys, order and all numbers to 1e-9."""
    protocol = _protocol(json.loads((case / "params.json").read_text()))
    ground_truth = read_ground_truth(case / "gt")
    predictions = load_predictions(case / "pred", ground_truth.images, protocol.labels)

    results = cityscapes_results(evaluate(ground_truth, predictions, protocol).scores)

    expected = json.loads((case / "expected.json").read_text())
    assert list(differences(json.loads(json.dumps(results)), expected)) == []


def test_there_are_recorded_cases() -> None:
    """The comparison above never passes for want of cases."""
    assert {"realistic60", "tiny_by_hand", "modal_iou50"} <= {case.name for case in RECORDED}
