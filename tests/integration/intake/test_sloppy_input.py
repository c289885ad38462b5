import json
from pathlib import Path

from evaluator.cityscapes_format import cityscapes_results
from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.intake import read_predictions, read_predictions_leniently
from tests.data.sloppy import write_sloppy_predictions
from tests.reference.process import reference_results, required_reference
from tests.results_comparison import differences

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"
SEEDS = range(2)
PARAMETERS = {
    "labels": ["car", "truck", "bus", "train", "motorcycle", "bicycle"],
    "min_iou": 0.7,
    "max_depth": 100,
    "step_size": 5,
    "modal": False,
    "cw": -1.0,
}


def test_lenient_numbers_equal_the_reference(tmp_path: Path) -> None:
    """On randomly damaged predictions the lenient reading gives every number of the reference; the strict one refuses."""
    python = required_reference()
    for seed in SEEDS:
        write_sloppy_predictions(CASE / "pred", tmp_path / str(seed), seed)
    ground_truth = read_ground_truth(CASE / "gt")

    sources = [tmp_path / str(seed) for seed in SEEDS]
    expected = reference_results(
        [{"gt": str(CASE / "gt"), "pred": str(source), "parameters": PARAMETERS} for source in sources], python
    )

    for source, theirs in zip(sources, expected, strict=True):
        intake = read_predictions_leniently(source, images=ground_truth.image_list())
        assert intake.predictions is not None
        ours = json.loads(json.dumps(cityscapes_results(evaluate(ground_truth, intake.predictions).scores)))
        assert list(differences(ours, theirs)) == []
        assert {group.severity for group in intake.report.groups} == {"note"}
        assert not read_predictions(source, images=ground_truth.image_list()).report.accepted
