import gc
import hashlib
import json
import os
import tracemalloc
import zipfile
from pathlib import Path

import msgspec
import pytest

from evaluator.archive.names import check_names
from evaluator.codes import MEANINGS, Code
from evaluator.file_names import NearestName
from evaluator.findings import Findings, quote
from evaluator.ground_truth import ImageList
from evaluator.intake import Intake, check_archive, read_predictions
from evaluator.limits import Limits
from evaluator.report import MAX_LOCATED_PROBLEMS, Problem
from tests.data.corpus_archives import BOX, EMPTY, IMAGES, PAIR
from tests.data.corpus_predictions import IMAGE, box, document
from tests.data.corpus_zip import STORED, Entry, write_zip


def _images(*names: str) -> ImageList:
    return ImageList(images=names, intrinsics_px=(), sensor_from_vehicle=())


def _read_one(folder: Path, data: bytes) -> Intake:
    (folder / f"{IMAGE}_pred.json").write_bytes(data)
    return read_predictions(folder, images=_images(IMAGE))


def _codes(intake: Intake) -> dict[str, int]:
    return {group.code: group.count for group in intake.report.groups}


def test_arrays_hold_what_the_files_say(tmp_path: Path) -> None:
    """Every number lands in its place, in the order of the images, then of the file; a missing modal box is the amodal."""
    path = tmp_path / "pred.zip"
    second = document(
        box(
            label='"bus"', score="0.25", amodal="[1, 2, 3, 4]", modal=None, center="[5, 6, 7]", dimensions="[8, 9, 10]"
        ),
        box(label='"caravan"'),
        box(score="0.5", rotation="[0, 0.6, 0, -0.8]"),
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{IMAGES[1]}_pred.json", second)
        archive.writestr(f"deep/er/{IMAGES[0]}_pred.json", BOX)
    boxes = read_predictions(path, images=_images(*IMAGES)).predictions
    assert boxes is not None
    assert boxes.image_index.tolist() == [0, 1, 1]
    assert [boxes.labels[index] for index in boxes.label_index] == ["car", "bus", "car"]
    assert boxes.score.tolist() == [0.9, 0.25, 0.5]
    assert boxes.center_m.tolist() == [[20.5, 1.25, 0.8], [5, 6, 7], [20.5, 1.25, 0.8]]
    assert boxes.dimensions_m.tolist() == [[4.5, 1.8, 1.5], [8, 9, 10], [4.5, 1.8, 1.5]]
    assert boxes.rotation.tolist() == [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0.6, 0, -0.8]]
    assert boxes.amodal_px.tolist() == [[900, 400, 100, 80], [1, 2, 3, 4], [900, 400, 100, 80]]
    assert boxes.modal_px.tolist() == [[900, 400, 90, 80], [1, 2, 3, 4], [905, 400, 90, 80]]
    assert (str(boxes.image_index.dtype), str(boxes.score.dtype)) == ("int32", "float64")


def test_many_batches_keep_their_order(tmp_path: Path) -> None:
    """More boxes than fit into a batch come out in order, whatever the images' order in the archive."""
    names = tuple(f"berlin_{number:06d}_000019" for number in range(70))
    path = tmp_path / "pred.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for number in reversed(range(70)):
            text = document(*(box(score=f"0.{number:03d}", center=f"[{place}, 0, 0]") for place in range(31)))
            archive.writestr(f"{names[number]}_p.json", text)
    calls: list[tuple[int, int]] = []
    intake = read_predictions(path, images=_images(*names), progress=lambda done, total: calls.append((done, total)))
    assert intake.predictions is not None
    assert intake.report.boxes == len(intake.predictions) == 70 * 31
    assert intake.predictions.score.tolist() == [float(f"0.{number:03d}") for number in range(70) for _ in range(31)]
    assert intake.predictions.center_m[:, 0].tolist() == list(range(31)) * 70
    assert calls == sorted(calls)
    assert calls[-1] == (70, 70)


def test_other_labels_may_be_evaluated(tmp_path: Path) -> None:
    """With labels given, the data set's other classes are left out and counted."""
    (tmp_path / f"{IMAGE}_pred.json").write_bytes(document(box(), box(label='"caravan"'), box(label='"bus"')))
    intake = read_predictions(tmp_path, images=_images(IMAGE), labels=("caravan",))
    assert intake.predictions is not None
    assert intake.predictions.labels == ("caravan",)
    assert len(intake.predictions) == 1
    (group,) = intake.report.groups
    assert (group.count, [(problem.found, problem.detail) for problem in group.problems]) == (
        2,
        [("bus", None), ("car", None)],
    )


def test_an_unknown_label_hides_no_other_box(tmp_path: Path) -> None:
    """The other boxes of its file are checked and counted, so that one upload tells everything."""
    boxes = (box(), box(label='"van"'), box(label='"caravan"'), box(score="2"))
    intake = _read_one(tmp_path, document(*boxes))
    found = {group.code: group.count for group in intake.report.groups}
    assert found == {"unknown_label": 1, "unevaluated_label": 1, "score_out_of_range": 1}
    assert intake.report.boxes == 2


def test_every_problem_is_located(tmp_path: Path) -> None:
    """A report names file, pointer, found and expected for each of several problems in one file."""
    report = _read_one(tmp_path, document(box(score='"0.9"'), box(dimensions="[1, -2, 3]", label='"a/b~c"'))).report
    problems = {group.code: group.problems for group in report.groups}
    file = f"{IMAGE}_pred.json"
    assert problems == {
        "wrong_type": (Problem(file=file, pointer="/objects/0/score", found='the string "0.9"', expected="a number"),),
        "unknown_label": (
            Problem(
                file=file,
                pointer="/objects/1/label",
                found="a/b~c",
                expected="bicycle, bus, car, caravan, motorcycle, trailer, train, truck",
            ),
        ),
        "dimension_out_of_range": (
            Problem(file=file, pointer="/objects/1/3d/dimensions/1", found="-2", expected="0.01 m to 100 m"),
        ),
    }


def test_keys_are_escaped_in_pointers(tmp_path: Path) -> None:
    """Slash and tilde of a key are written as RFC 6901 wants it."""
    report = _read_one(tmp_path, document(more=', "a/b~": NaN')).report
    assert report.groups[0].problems[0].pointer == "/a~1b~0"


def test_syntax_errors_say_line_and_column(tmp_path: Path) -> None:
    """The place of broken JSON is given as line and column."""
    (problem,) = _read_one(tmp_path, b'{"objects": [\n  {"label": "car",}\n]}').report.groups[0].problems
    assert problem.detail is not None
    assert "line 2, column 19" in problem.detail


def test_counts_are_complete_and_located_problems_capped(tmp_path: Path) -> None:
    """Thousands of problems are counted; a rare one keeps its place beside them."""
    boxes = [box(score="2", center="[1e5, 0, 0]")] * 900 + [box(label='"van"')]
    report = _read_one(tmp_path, document(*boxes)).report
    located = {group.code: len(group.problems) for group in report.groups}
    assert {group.code: group.count for group in report.groups if group.severity == "error"} == {
        "unknown_label": 1,
        "score_out_of_range": 900,
        "center_out_of_range": 900,
    }
    # 1000 places: the rare one (and the doctor's hint on scores) in full, the rest shared evenly
    assert sum(located.values()) == MAX_LOCATED_PROBLEMS
    assert located["unknown_label"] == 1
    assert abs(located["score_out_of_range"] - located["center_out_of_range"]) <= 1


def test_errors_come_before_warnings_and_notes(tmp_path: Path) -> None:
    """The report is sorted by severity."""
    boxes = (box(label='"caravan"'), box(rotation="[2, 0, 0, 0]"), box(score="2"))
    report = _read_one(tmp_path, document(*boxes)).report
    assert [group.severity for group in report.groups] == ["error", "warning", "note"]


@pytest.mark.parametrize(
    ("file", "hint"),
    [
        ("berlin_00001_000019_pred.json", "perhaps the image berlin_000001_000019"),
        ("berlin_000001_00019_pred.json", "perhaps the image berlin_000001_000019"),
        ("Berlin_000001_000019_pred.json", "perhaps the image berlin_000001_000019"),
        ("berlin_000001-000019_pred.json", "perhaps the image berlin_000001_000019"),
        ("brelin_000001_000019_pred.json", "perhaps the image berlin_000001_000019"),
        ("berlin_1_19_pred.json", "perhaps the image berlin_000001_000019"),
        ("berlin_000001_000019.json", "the name lacks a part after the image: berlin_000001_000019_<anything>.json"),
        ("hamburg_000777_000019_pred.json", None),
    ],
)
def test_typing_errors_are_recognised(tmp_path: Path, file: str, hint: str | None) -> None:
    """A missing image and a misspelt file are brought together."""
    (tmp_path / f"{IMAGES[0]}_pred.json").write_bytes(EMPTY)
    (tmp_path / file).write_bytes(EMPTY)
    groups = {group.code: group.problems for group in read_predictions(tmp_path, images=_images(*IMAGES)).report.groups}
    assert groups["unknown_image"][0].detail == hint
    assert groups["missing_image"][0].expected == f"{IMAGES[1]}_<anything>.json"
    assert groups["missing_image"][0].detail == (None if hint is None else f"perhaps {file}")


def test_without_images_only_the_names_form_is_checked(tmp_path: Path) -> None:
    """Nothing is missing when nobody says what there should be."""
    (tmp_path / "berlin_000001_000019_pred.json").write_bytes(BOX)
    intake = read_predictions(tmp_path, images=None)
    assert intake.report.accepted
    assert intake.predictions is not None
    assert intake.predictions.images == ("berlin_000001_000019",)
    (tmp_path / "whatever.json").write_bytes(BOX)
    assert _codes(read_predictions(tmp_path, images=None)) == {"unknown_image": 1}


def test_folder_and_zip_give_the_same(tmp_path: Path) -> None:
    """A folder is read by the same rules as a zip."""
    folder, path = tmp_path / "pred", tmp_path / "pred.zip"
    folder.mkdir()
    for entry in PAIR:
        (folder / entry.name.decode()).write_bytes(entry.data)
    path.write_bytes(write_zip(PAIR))
    one, two = (read_predictions(source, images=_images(*IMAGES)) for source in (folder, path))
    assert one.report == two.report
    assert one.sha256 != two.sha256
    assert len(one.sha256) == len(two.sha256) == 64


@pytest.mark.parametrize("in_memory", [True, False])
def test_digest_of_a_zip_is_that_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, in_memory: bool
) -> None:
    """Whether it is held in memory or read piece by piece, and also where it cannot be opened."""
    monkeypatch.setattr("evaluator.archive.source._SMALL_BYTES", 1 << 25 if in_memory else 0)
    path = tmp_path / "pred.zip"
    noise = Entry(
        name=b"noise.txt", data=b"".join(number.to_bytes(4, "little") for number in range(700_000)), method=STORED
    )
    for archive in (write_zip(PAIR), write_zip([*PAIR, noise]), b"no zip"):
        path.write_bytes(archive)
        intake = read_predictions(path, images=_images(*IMAGES))
        assert intake.sha256 == hashlib.sha256(archive).hexdigest()


def test_digest_of_a_folder_depends_on_names_and_contents(tmp_path: Path) -> None:
    """Renaming a file or moving a byte from one to the next changes the digest; reading again does not."""
    digests: set[str] = set()
    for files in ({"a": b"xy", "b": b""}, {"a": b"x", "b": b"y"}, {"a": b"xy", "c": b""}, {"a": b"xy", "b": b""}):
        folder = tmp_path / str(len(digests))
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        for name, data in files.items():
            (folder / name).write_bytes(data)
        digests.add(read_predictions(folder, images=None).sha256)
    assert len(digests) == 3


def test_links_and_devices_in_folders_are_refused(tmp_path: Path) -> None:
    """A folder's links, to files or folders, and pipes are not followed."""
    (tmp_path / "secret").mkdir()
    folder = tmp_path / "pred"
    folder.mkdir()
    (folder / f"{IMAGES[0]}_pred.json").symlink_to("/etc/passwd")
    (folder / "linked").symlink_to(tmp_path / "secret")
    os.mkfifo(folder / f"{IMAGES[1]}_pred.json")
    assert _codes(read_predictions(folder, images=_images(*IMAGES))) == {"link_or_device": 3}


def test_unreadable_sources_are_reported(tmp_path: Path) -> None:
    """A path that is not there, or is a pipe, gives a report, not an exception."""
    os.mkfifo(tmp_path / "pipe")
    for source in (tmp_path / "nothing", tmp_path / "pipe", Path("a\0b")):
        intake = read_predictions(source, images=None)
        assert (_codes(intake), intake.sha256) == ({"unreadable": 1}, "")


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        (Limits(archive_bytes=100), "archive_too_large"),
        (Limits(entries=1), "too_many_entries"),
        (Limits(expanded_bytes=100), "expanded_too_large"),
        (Limits(file_bytes=100), "file_too_large"),
        (Limits(ratio=1, ratio_floor_bytes=10), "ratio_too_high"),
        (Limits(name_bytes=10), "name_too_long"),
        (Limits(boxes_per_image=0), "too_many_boxes"),
        (Limits(json_depth=3), "nested_too_deeply"),
    ],
)
def test_every_limit_is_held(tmp_path: Path, limits: Limits, code: str) -> None:
    """Each cap refuses with its own code, in a zip and, where it applies, in a folder."""
    path = tmp_path / "pred.zip"
    packed = Entry(name=PAIR[0].name, data=BOX[:-1] + b', "deep": [[[]]]' + b" " * 900 + b"}")
    path.write_bytes(write_zip([packed, PAIR[1]]))
    assert code in _codes(read_predictions(path, images=_images(*IMAGES), limits=limits))
    folder = tmp_path / "folder"
    folder.mkdir()
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    if code not in {"archive_too_large", "ratio_too_high"}:
        assert code in _codes(read_predictions(folder, images=_images(*IMAGES), limits=limits))


def test_boxes_beyond_the_cap_are_not_explained(tmp_path: Path) -> None:
    """Of three bad boxes where two are allowed, two are explained: a file of millions must not take minutes."""
    (tmp_path / f"{IMAGE}_pred.json").write_bytes(document(*[box(label='"van"')] * 3))
    intake = read_predictions(tmp_path, images=_images(IMAGE), limits=Limits(boxes_per_image=2))
    assert _codes(intake) == {"unknown_label": 2, "too_many_boxes": 1}


def test_explaining_ends_at_its_limit(tmp_path: Path) -> None:
    """Beyond the limit files that are wrong are only counted, so that nobody can buy hours of explanations."""
    for name in IMAGES:
        (tmp_path / f"{name}_pred.json").write_bytes(document(box(score="2")))
    limits = Limits(explained_bytes=len(document(box(score="2"))))
    intake = read_predictions(tmp_path, images=_images(*IMAGES), limits=limits)
    assert {code: count for code, count in _codes(intake).items() if code != "scores_in_percent"} == {
        "score_out_of_range": 1,
        "not_explained": 1,
    }


def test_quick_check_needs_no_inflating(tmp_path: Path) -> None:
    """The framing check passes damaged data by and finds false headers."""
    path = tmp_path / "pred.zip"
    path.write_bytes(write_zip([PAIR[0], Entry(name=PAIR[1].name, data=EMPTY, stated_crc32=1)]))
    assert check_archive(path).accepted
    path.write_bytes(write_zip([PAIR[0], Entry(name=b"../x_pred.json", data=EMPTY)]))
    assert [group.code for group in check_archive(path).groups] == ["parent_name"]


def test_collector_is_put_back() -> None:
    """The garbage collector runs again after a reading."""
    assert gc.isenabled()
    read_predictions(Path("nothing"), images=None)
    assert gc.isenabled()


def test_hostile_text_is_made_printable() -> None:
    """Control characters, lone surrogates and endless text do not reach a report."""
    assert quote("a\x1b[31m\n\ud800") == "a\\x1b[31m\\n\\ud800"
    assert len(quote("\x00" * 500)) <= 120
    assert quote("größe") == "größe"
    findings = Findings()
    findings.add(Code.UNEXPECTED_FILE, file="\udcff\n", found="x")
    report = findings.report(images_expected=0, images_found=0, boxes=0)
    assert json.loads(msgspec.json.encode(report))["groups"][0]["problems"][0]["file"] == "\\udcff\\n"


def test_many_unknown_names_take_little_memory(tmp_path: Path) -> None:
    """However many long names an archive has, the search for slips of the pen files a bounded number of forms."""
    names = [f"{number:05d}" + "x" * 75 for number in range(20_000)]
    # 80 characters: the name, the name without leading zeros, and 80 with one character less, some of them equal
    assert len(NearestName(names)) < 101_000
    (tmp_path / "berlin_00001_000019_pred.json").write_bytes(EMPTY)
    hints = _codes_with_details(read_predictions(tmp_path, images=_images(*(f"{name}_1_2" for name in names), IMAGE)))
    assert len(hints["missing_image"]) <= MAX_LOCATED_PROBLEMS


@pytest.mark.parametrize("name", ["0/" + "a/" * 500, "a" + ". -" * 330, "a " * 500, "a" * 30_000])
def test_hostile_names_take_little_memory(name: str) -> None:
    """However deep or long names are, checking them takes a few times their own bytes."""
    names = [f"{number}/{name}b" for number in range(200)]
    tracemalloc.start()
    try:
        check_names(names, Limits(), Findings())
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 4 * sum(map(len, names))


def _codes_with_details(intake: Intake) -> dict[str, list[str | None]]:
    return {group.code: [problem.detail for problem in group.problems] for group in intake.report.groups}


def test_without_any_prediction_only_that_is_said(tmp_path: Path) -> None:
    """An empty folder, and an archive of folders only, are one problem, not as many as there are images."""
    folder, path = tmp_path / "empty", tmp_path / "empty.zip"
    folder.mkdir()
    path.write_bytes(write_zip([Entry(name=b"predictions/", method=STORED)]))
    for source in (folder, path):
        assert _codes(read_predictions(source, images=_images(*IMAGES))) == {"empty_archive": 1}
    (group,) = check_archive(path).groups
    assert (group.code, group.problems[0].found) == ("empty_archive", "folders and system files at most")


def test_undecodable_file_names_of_a_folder_are_reported(tmp_path: Path) -> None:
    """A name that is not UTF-8 gives a report that can be written as JSON."""
    (tmp_path / os.fsdecode(b"\xff\xfe_pred.json")).write_bytes(EMPTY)
    intake = read_predictions(tmp_path, images=_images(IMAGE))
    assert "unknown_image" in _codes(intake)
    msgspec.json.encode(intake.report)


def test_every_code_has_a_meaning() -> None:
    """Each code has a severity, a title and a fix, each one sentence or more."""
    assert set(MEANINGS) == set(Code)
    for code, meaning in MEANINGS.items():
        assert code == code.lower()
        assert meaning.title.endswith((".", "?"))
        assert meaning.fix.endswith(".")
