import json
from pathlib import Path

import msgspec
import pytest

from client.main import main
from evaluator.ground_truth import ImageList, read_ground_truth
from tests.data.corpus_archives import IMAGES, PAIR
from tests.data.corpus_predictions import box, document
from tests.data.corpus_zip import write_zip

ORACLE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """A valid submission for two images."""
    path = tmp_path / "pred.zip"
    path.write_bytes(write_zip(PAIR))
    return path


def test_valid_submission_gives_status_0(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing wrong: one line, and a word on what was not looked for."""
    assert main(["validate", str(archive)]) == 0
    assert capsys.readouterr().out == (
        f"{archive}: valid, 1 boxes in 2 images. Missing images were not looked for; give --images.\n"
    )


def test_problems_give_status_1_and_a_table(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each problem appears with its code, its count and where it is."""
    third = "hamburg_000002_000019"
    listing = archive.parent / "images.txt"
    listing.write_text("\n".join((*IMAGES, third)))
    assert main(["validate", str(archive), "--images", str(listing)]) == 1
    printed = capsys.readouterr().out
    assert "missing_image" in printed
    assert f"expected {third}_<anything>.json" in printed
    assert printed.endswith("not valid, 1 boxes in 2 of 3 images.\n")


def test_long_lists_are_shortened(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Twenty places of a problem are shown, the rest is counted."""
    (tmp_path / f"{IMAGES[0]}_pred.json").write_bytes(document(*[box(label='"van"')] * 33))
    assert main(["validate", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    assert "/objects/19/label" in printed
    assert "/objects/20/label" not in printed
    assert "and 13 more" in printed


def test_report_as_json(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--json prints the whole report with verdict and digest, and nothing else."""
    assert main(["validate", str(archive), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document) == ["accepted", "sha256", "groups", "images_expected", "images_found", "boxes"]
    assert (document["accepted"], document["groups"], document["boxes"]) == (True, [], 1)


@pytest.mark.parametrize("form", ["folder", "list", "names"])
def test_images_may_be_given_in_several_forms(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ground truth, an image list as JSON, and a text file of names all say which images there must be."""
    images = read_ground_truth(ORACLE / "gt").image_list()
    source = ORACLE / "gt"
    if form != "folder":
        source = tmp_path / form
        source.write_bytes(msgspec.json.encode(images) if form == "list" else "\n".join(images.images).encode())
    assert main(["validate", str(ORACLE / "pred"), "--images", str(source), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["images_expected"], report["images_found"], report["groups"]) == (60, 60, [])


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"images": 1}'])
def test_unusable_image_lists_are_wrong_usage(
    archive: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    """A list that cannot be read gives status 2 and says why."""
    listing = archive.parent / "images"
    listing.write_bytes(content)
    assert main(["validate", str(archive), "--images", str(listing)]) == 2
    assert "--images" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [["nothing.zip"], ["{archive}", "--images", "nothing"], ["{archive}", "--images", "."]]
)
def test_missing_paths_are_wrong_usage(
    archive: Path, arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths that are not there, or a folder without ground truth, give status 2."""
    empty = archive.parent / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    assert main(["validate", *(argument.format(archive=archive) for argument in arguments)]) == 2
    assert capsys.readouterr().err.startswith("cs3d: ")


def test_image_list_survives_json() -> None:
    """The JSON form of an image list is what the command reads."""
    images = ImageList(images=IMAGES, intrinsics_px=(), sensor_from_vehicle=())
    assert msgspec.json.decode(msgspec.json.encode(images), type=ImageList) == images
