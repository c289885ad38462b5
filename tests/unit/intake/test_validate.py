import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from client.main import main
from evaluator.ground_truth import ImageList, read_ground_truth
from tests.data.corpus_archives import IMAGES, PAIR
from tests.data.corpus_predictions import box, document
from tests.data.corpus_zip import write_zip

ROOT = Path(__file__).parents[3]
ORACLE = ROOT / "tests" / "data" / "oracle" / "realistic60"


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
        f"{archive}: valid, 1 box in 2 images. Missing images were not looked for; give --images.\n"
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
    assert printed.endswith("not valid, 1 box in 2 of 3 images.\n")


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


@pytest.mark.parametrize("name", ["gt.ZIP", "gt"])
def test_zipped_ground_truth_is_known_by_its_bytes(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ground truth in a zip says which images there must be, whatever the zip is called."""
    packed = shutil.make_archive(str(tmp_path / "packed"), "zip", ORACLE / "gt")
    source = Path(packed).rename(tmp_path / name)
    assert main(["validate", str(ORACLE / "pred"), "--images", str(source), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images_expected"] == 60


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("Some text that is\nno list of images\n", "'Some text that is'"),
        (f"{IMAGES[0]}_pred.json\n", f"'{IMAGES[0]}_pred.json'"),
        (f"berlin/{IMAGES[0]}\n", f"'berlin/{IMAGES[0]}'"),
        ("\n \n", "names no image"),
        ('{"images": [], "intrinsics_px": [], "sensor_from_vehicle": []}', "names no image"),
        ('{"images": ["x"], "intrinsics_px": [], "sensor_from_vehicle": []}', "'x'"),
        (f'{{"images": {json.dumps([IMAGES[0]] * 2)}, "intrinsics_px": [], "sensor_from_vehicle": []}}', "twice"),
        (f'{{"images": ["{IMAGES[0]}"], "intrinsics_px": [[1, 1, 0, 0]], "sensor_from_vehicle": []}}', "every image"),
        (
            f'{{"images": ["{IMAGES[0]}"], "intrinsics_px": [[1, 1, 0, 0]], "sensor_from_vehicle": [[[1, 0, 0, 0]]]}}',
            "3 x 4",
        ),
    ],
)
def test_other_texts_are_no_image_list(
    archive: Path, content: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What names anything but images is wrong usage, and the message quotes it."""
    listing = archive.parent / "images.txt"
    listing.write_text(content)
    assert main(["validate", str(archive), "--images", str(listing)]) == 2
    assert says in capsys.readouterr().err


def test_image_lists_of_other_editors_are_read(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A byte order mark, Windows line ends, blanks and empty lines do not matter."""
    listing = archive.parent / "images.txt"
    listing.write_bytes(b"\xef\xbb\xbf" + f"{IMAGES[1]} \r\n\r\n{IMAGES[0]}\r\n".encode())
    assert main(["validate", str(archive), "--images", str(listing)]) == 0
    assert capsys.readouterr().out.endswith("valid, 1 box in 2 of 2 images.\n")


def test_a_refused_archive_is_not_said_to_have_no_images(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """When the framing is refused, nothing was counted, and no number pretends it was."""
    archive.write_bytes(archive.read_bytes() + b"more")
    listing = archive.parent / "images.txt"
    listing.write_text("\n".join(IMAGES))
    assert main(["validate", str(archive), "--images", str(listing)]) == 1
    printed = capsys.readouterr().out
    assert printed.endswith(f"{archive}: not valid, nothing in it was read.\n")
    assert "0 of 0" not in printed


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_reader_that_goes_away_is_no_error(tmp_path: Path, options: list[str]) -> None:
    """When nobody reads the output any more, as behind `| head -1`, the command ends quietly with status 0."""
    boxes = [box(label='"van"')] * 900
    (tmp_path / f"{IMAGES[0]}_pred.json").write_bytes(document(*boxes))
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "client.main", "validate", str(tmp_path), *options]
    ended = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, cwd=ROOT, check=False)
    os.close(writing)
    assert (ended.returncode, ended.stderr) == (0, b"")
