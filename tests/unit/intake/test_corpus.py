import json
import re
from pathlib import Path

import pytest

from client.main import main
from evaluator.archive import check_framing
from evaluator.codes import MEANINGS, Code
from evaluator.findings import Findings
from evaluator.ground_truth import ImageList
from evaluator.intake import check_archive, read_predictions
from evaluator.limits import DEFAULT_LIMITS
from tests.data.corpus_archives import IMAGES
from tests.data.corpus_predictions import IMAGE
from tests.data.make_corpus import DATA, expected_codes, make_corpus

ARCHIVES = sorted((DATA / "archives").glob("*/*.zip"))
PREDICTIONS = sorted((DATA / "predictions").glob("*/*.json"))


def _images(names: tuple[str, ...]) -> ImageList:
    return ImageList(images=names, intrinsics_px=(), sensor_from_vehicle=())


def _validate(
    source: Path, names: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[int, list[str]]:
    """Run `cs3d validate --json` and give its exit status and the codes it prints."""
    listing = folder / "images.txt"
    listing.write_text("\n".join(names))
    status = main(["validate", str(source), "--images", str(listing), "--json"])
    return status, sorted(group["code"] for group in json.loads(capsys.readouterr().out)["groups"])


def test_corpus_is_large_enough() -> None:
    """The corpus holds at least a hundred cases, and both kinds of both."""
    assert len(ARCHIVES) + len(PREDICTIONS) >= 100
    kinds = {(path.parent.parent.name, path.parent.name) for path in (*ARCHIVES, *PREDICTIONS)}
    assert len(kinds) == 4


def test_corpus_is_what_its_script_writes(tmp_path: Path) -> None:
    """The files in the tree are those that the script writes; only the packing may differ between zlib versions."""
    make_corpus(tmp_path)
    for kind in ("archives", "predictions"):
        written = {path.relative_to(tmp_path) for path in (tmp_path / kind).glob("*/*")}
        assert written == {path.relative_to(DATA) for path in (DATA / kind).glob("*/*")}
    for path in PREDICTIONS:
        assert path.read_bytes() == (tmp_path / path.relative_to(DATA)).read_bytes()


def test_corpus_holds_every_error_of_archives_and_files() -> None:
    """Every error code has a case in the corpus, but for those that need an impossible file or another limit."""
    elsewhere = {Code.UNREADABLE, Code.ARCHIVE_TOO_LARGE, Code.NOT_EXPLAINED}
    errors = {code for code in Code if MEANINGS[code].severity == "error"} - elsewhere
    assert errors == {Code(code) for path in (*ARCHIVES, *PREDICTIONS) for code in expected_codes(path)} & errors


@pytest.mark.parametrize("path", ARCHIVES, ids=lambda path: f"{path.parent.name}-{path.name.split('.')[0]}")
def test_archive(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Reading an archive gives exactly the codes in its name, and so does the command line."""
    intake = read_predictions(path, images=_images(IMAGES))
    assert tuple(sorted(group.code for group in intake.report.groups)) == expected_codes(path)
    assert intake.report.accepted == (path.parent.name == "accept") == (intake.predictions is not None)
    if intake.predictions is not None:
        assert intake.predictions.images == IMAGES
        assert intake.predictions.score.tolist() == [0.9]  # BOX in the first image, nothing in the second
    status = 0 if path.parent.name == "accept" else 1
    assert _validate(path, IMAGES, tmp_path, capsys) == (status, list(expected_codes(path)))


@pytest.mark.parametrize("path", ARCHIVES, ids=lambda path: f"{path.parent.name}-{path.name.split('.')[0]}")
def test_quick_check_refuses_nothing_that_reading_accepts(path: Path) -> None:
    """The framing check alone finds a part of what the whole reading finds, so it may refuse an upload early."""
    codes = {group.code for group in check_archive(path).groups}
    assert codes <= set(expected_codes(path))


@pytest.mark.parametrize("path", ARCHIVES, ids=lambda path: f"{path.parent.name}-{path.name.split('.')[0]}")
def test_quick_check_finds_what_the_documentation_says(path: Path) -> None:
    """Codes from `not_a_zip` to `file_too_large`, and sizes that are contradicted; of these two need the contents, too."""
    order = list(Code)
    at_the_door = set(order[order.index(Code.NOT_A_ZIP) : order.index(Code.FILE_TOO_LARGE) + 1])
    codes = {group.code for group in check_archive(path).groups}
    assert codes <= at_the_door | {Code.SIZE_MISMATCH}
    assert at_the_door & set(expected_codes(path)) - codes <= {Code.EMPTY_ARCHIVE, Code.NESTED_ARCHIVE}


@pytest.mark.parametrize("path", PREDICTIONS, ids=lambda path: f"{path.parent.name}-{path.name.split('.')[0]}")
def test_prediction_file(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Reading a file gives exactly the codes in its name, each located, and so does the command line."""
    folder = tmp_path / "predictions"
    folder.mkdir()
    (folder / f"{IMAGE}_pred.json").write_bytes(path.read_bytes())
    intake = read_predictions(folder, images=_images((IMAGE,)))
    assert tuple(sorted(group.code for group in intake.report.groups)) == expected_codes(path)
    assert intake.report.accepted == (path.parent.name == "accept") == (intake.predictions is not None)
    for group in intake.report.groups:
        assert group.count >= 1
        assert all(problem.file == f"{IMAGE}_pred.json" for problem in group.problems if group.severity == "error")
    status = 0 if path.parent.name == "accept" else 1
    assert _validate(folder, (IMAGE,), tmp_path, capsys) == (status, list(expected_codes(path)))


@pytest.mark.parametrize(
    "path",
    [path for path in PREDICTIONS if path.parent.name == "reject"][::9],
    ids=lambda path: path.name.split(".")[0],
)
def test_pointers_lead_to_something(path: Path, tmp_path: Path) -> None:
    """Where a document can be parsed, each pointer names a place in it."""
    (tmp_path / f"{IMAGE}_pred.json").write_bytes(path.read_bytes())
    report = read_predictions(tmp_path, images=_images((IMAGE,))).report
    for pointer in (problem.pointer for group in report.groups for problem in group.problems if problem.pointer):
        value = json.loads(path.read_bytes())
        for part in pointer.split("/")[1:]:
            value = value[int(part) if isinstance(value, list) else re.sub("~1", "/", part).replace("~0", "~")]


@pytest.mark.parametrize("step", range(1, 12, 3))
def test_every_cut_of_an_archive_is_refused(step: int) -> None:
    """An archive that ends early anywhere is refused without a crash."""
    data = (DATA / "archives" / "accept" / "info_zip_from_pipe.zip").read_bytes()
    for length in range(0, len(data), step):
        findings = Findings()
        check_framing(data[:length], DEFAULT_LIMITS, findings)
        assert findings.error_count
