import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from evaluator.archive import digest
from evaluator.cityscapes_format import cityscapes_results
from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.intake import Intake, read_predictions, read_predictions_leniently
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol
from tests.data.corpus_archives import IMAGES, PAIR
from tests.data.corpus_predictions import box, document
from tests.data.corpus_zip import write_zip
from tests.reference.process import reference_results, required_reference
from tests.results_comparison import differences

ORACLE = Path(__file__).parents[2] / "data" / "oracle"
CAMERA = {
    "fx": 2262.5,
    "fy": 2265.3,
    "u0": 1097.0,
    "v0": 513.1,
    "sensor_T_ISO_8855": [[1, 0, 0, -1.65], [0, 1, 0, -0.13], [0, 0, 1, -1.28]],
}


@pytest.fixture
def ground_truth(tmp_path: Path) -> Path:
    """Two images with a car each."""
    folder = tmp_path / "gt"
    folder.mkdir()
    for name in IMAGES:
        car: dict[str, Any] = json.loads(box(amodal="[822, 476, 251, 205]", modal=None))
        content = {"imgWidth": 2048, "imgHeight": 1024, "sensor": CAMERA, "objects": [car], "ignore": []}
        (folder / f"{name}_gtBbox3d.json").write_text(json.dumps(content))
    return folder


def _read(ground_truth: Path, files: dict[str, bytes]) -> Intake:
    """Read files leniently."""
    folder = ground_truth.parent / "pred"
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return read_predictions_leniently(folder, images=read_ground_truth(ground_truth).image_list())


def _codes(intake: Intake) -> dict[str, int]:
    return {group.code: group.count for group in intake.report.groups}


@pytest.mark.parametrize("case", sorted(path.name for path in ORACLE.iterdir()))
def test_valid_predictions_read_the_same(case: str) -> None:
    """On valid input both readings give the same arrays."""
    images = read_ground_truth(ORACLE / case / "gt").image_list()
    strict = read_predictions(ORACLE / case / "pred", images=images).predictions
    lenient = read_predictions_leniently(ORACLE / case / "pred", images=images)
    assert lenient.report.groups == ()
    assert strict is not None
    assert lenient.predictions is not None
    for name in (
        "image_index",
        "label_index",
        "score",
        "center_m",
        "dimensions_m",
        "rotation",
        "amodal_px",
        "modal_px",
    ):
        np.testing.assert_array_equal(getattr(strict, name), getattr(lenient.predictions, name))


def test_everything_the_reference_passes_over_is_named(ground_truth: Path) -> None:
    """A missing image, extra and replaced files, odd boxes and scores are taken as the reference takes them, with notes."""
    intake = _read(
        ground_truth,
        {
            f"a/{IMAGES[0]}_old.json": document(box(), box()),
            f"b/{IMAGES[0]}_new.json": document(
                box(),
                box(label='"Car"'),
                box().replace('"label"', '"class"'),
                box(center="[1, 2]"),
                box(score="1.5"),
                box(score="-1e-9"),
                box(score="NaN"),
            ),
            "a/bonn_000000_000019_pred.json": b"broken",
            "a/results.json": b"{}",
        },
    )
    assert _codes(intake) == {
        "lenient_missing_image": 1,
        "lenient_extra_file": 1,
        "lenient_replaced_file": 1,
        "lenient_skipped_label": 2,
        "lenient_skipped_object": 1,
        "lenient_score": 3,
    }
    assert intake.report.accepted
    assert intake.predictions is not None
    assert intake.predictions.images == IMAGES
    np.testing.assert_array_equal(intake.predictions.score, [0.9, 1.5, -1e-9, np.nan])


@pytest.mark.parametrize(
    "broken",
    [
        box(center="[NaN, 0, 0]"),
        box(center="[0, -Infinity, 0]"),
        box(center="[1e30, 0, 0]"),
        box(dimensions="[NaN, 1, 1]"),
        box(rotation="[Infinity, 0, 0, 0]"),
    ],
)
@pytest.mark.parametrize("protocol", [CITYSCAPES3D, replace(CITYSCAPES3D, modal=True), PAPER], ids=str)
def test_boxes_that_cannot_be_calculated_with_are_skipped(ground_truth: Path, broken: str, protocol: Protocol) -> None:
    """Beside such a box every score is what it is without it, under every protocol, and a note counts it."""
    truth = read_ground_truth(ground_truth)
    scores = []
    for boxes in ([box()], [box(), broken]):
        intake = _read(ground_truth, {f"{name}_pred.json": document(*boxes) for name in IMAGES})
        assert intake.predictions is not None
        scores.append(evaluate(truth, intake.predictions, protocol).scores)

    assert _codes(intake) == {"lenient_skipped_object": len(IMAGES)}
    assert scores[0] == scores[1]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (b"{", "invalid_json"),
        (b"\xff", "invalid_utf8"),
        (b"[]", "missing_key"),
        (b"{}", "missing_key"),
        (b'{"objects": 1}', "missing_key"),
    ],
)
def test_a_needed_file_that_the_reference_cannot_read_is_an_error(ground_truth: Path, text: bytes, code: str) -> None:
    """The reference aborts on these."""
    intake = _read(ground_truth, {f"{name}_pred.json": text for name in IMAGES})
    assert _codes(intake) == {code: 2}
    assert intake.predictions is None


def test_links_to_files_are_followed(ground_truth: Path, tmp_path: Path) -> None:
    """A folder with links is read here, and refused by the strict reading."""
    target = tmp_path / "target.json"
    target.write_bytes(document(box()))
    folder = tmp_path / "pred"
    folder.mkdir()
    for name in IMAGES:
        (folder / f"{name}_pred.json").symlink_to(target)
    images = read_ground_truth(ground_truth).image_list()
    assert read_predictions_leniently(folder, images=images).report.groups == ()
    strict = read_predictions(folder, images=images).report
    assert {group.code for group in strict.groups} == {"link_or_device", *(set() if strict.images_found else ())}


def test_the_digest_is_of_what_links_lead_to(ground_truth: Path, tmp_path: Path) -> None:
    """Links and copies of the same files have one digest; with other content it is another one."""
    images = read_ground_truth(ground_truth).image_list()
    digests = []
    for number, content in enumerate((document(box()), document(box()), document())):
        target, folder = tmp_path / f"{number}.json", tmp_path / f"pred{number}"
        target.write_bytes(content)
        folder.mkdir()
        for name in IMAGES:
            path = folder / f"{name}_pred.json"
            path.symlink_to(target) if number else path.write_bytes(content)
        digests.append(read_predictions_leniently(folder, images=images).sha256)

    assert digests[0] == digests[1] == digest(tmp_path / "pred0")
    assert digests[2] not in {digests[0], ""}


def test_zip_is_read_leniently_too(ground_truth: Path, tmp_path: Path) -> None:
    """A zip works like a folder, but its framing is still checked."""
    images = read_ground_truth(ground_truth).image_list()
    path = tmp_path / "pred.zip"
    path.write_bytes(write_zip(PAIR))
    assert read_predictions_leniently(path, images=images).report.boxes == 1
    path.write_bytes(b"junk" + write_zip(PAIR))
    assert _codes(read_predictions_leniently(path, images=images)) == {"prefix_bytes": 1}


SLOPPY = {
    f"z/{IMAGES[0]}_1.json": document(box()),
    f"z/{IMAGES[0]}_2.json": document(
        box(rotation="[3, 0, 0, 0.5]"),
        box(rotation='["1", "0", "0", "0"]', score="0.4"),
        box(score="1.5", center="[20.4, 1.3, 0.8]"),
        box(score="true"),
        box(score="[0.5]"),
        box(score="Infinity"),
        box(score="-0.5"),
        box(score="NaN"),
        box(label='"Car"'),
        box(label="null"),
        box(rotation="[0, 0, 0, 0]", modal="[822, 476, 251, 205]"),
        box(modal='[1, 2, 3, 4], "bbox": [1, 2, 3, 4], "bboxVis": [900, 400, 5, 5, 7]'),
        box(amodal='"none"', modal="[900, 400, 5, 5]"),
        box(more=', "score": 0.25'),
        box().replace('"3d"', '"4d"'),
        box().replace('"amodal"', '"amodel"'),
        "{}",
        more=', "weight": NaN',
    ),
    "bonn_000000_000019_x.json": document(box()),
    "results.json": b"",
}


@pytest.mark.parametrize("modal", [False, True])
def test_numbers_on_sloppy_input_equal_the_reference(ground_truth: Path, modal: bool) -> None:  # noqa: FBT001 -- a case
    """On input that only the lenient reading takes, every number of the reference's results is reproduced."""
    python = required_reference()
    intake = _read(ground_truth, SLOPPY)
    assert intake.predictions is not None
    protocol = replace(CITYSCAPES3D, modal=modal)
    ours = cityscapes_results(evaluate(read_ground_truth(ground_truth), intake.predictions, protocol).scores)
    parameters = {
        "labels": ["car", "truck", "bus", "train", "motorcycle", "bicycle"],
        "min_iou": 0.7,
        "max_depth": 100,
        "step_size": 5,
        "modal": modal,
        "cw": -1.0,
    }
    case = {"gt": str(ground_truth), "pred": str(ground_truth.parent / "pred"), "parameters": parameters}
    (theirs,) = reference_results([case], python)
    assert theirs["AP"]["car"]["auc"] > 0  # not all is lost
    assert not list(differences(json.loads(json.dumps(ours)), theirs))
