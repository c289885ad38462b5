"""`cs3d diagnose` and `cs3d compare`: tables and JSON from folders of files."""

import json
import re
import shutil
from pathlib import Path

import msgspec
import pytest

from client.main import main
from client.text_table import number, percent, points, text_table
from evaluator.comparison.summary import ComparisonMetrics
from evaluator.diagnosis.diagnose import Diagnosis
from evaluator.diagnosis.difference import Difference
from evaluator.intake import read_predictions

CASE = Path(__file__).parents[2] / "data" / "oracle" / "tiny_by_hand"
ARGUMENTS = ["--gt", str(CASE / "gt")]


@pytest.fixture
def worse(tmp_path: Path) -> Path:
    """Return the case's predictions with every box 5 % too long."""
    for path in sorted((CASE / "pred").glob("*.json")):
        document = json.loads(path.read_text())
        for item in document["objects"]:
            item["3d"]["dimensions"][0] *= 1.05
        (tmp_path / path.name).write_text(json.dumps(document))
    return tmp_path


def test_diagnose_prints_every_table(capsys: pytest.CaptureFixture[str]) -> None:
    """Loss, causes, oracles, errors, kinds of objects and scores come with the signature below them."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred")]) == 0
    printed = capsys.readouterr().out
    for title in ("Where 100 points go", "Causes", "Oracles", "Mean errors", "by kind of object", "Scores", "right"):
        assert title in printed
    assert printed.splitlines()[-1].startswith("cityscapes3d:1|")
    assert "As KITTI" not in printed
    assert "bicycle: true positives in fewer than two depth bins" in printed  # half of them are found, in one bin


def test_diagnose_shows_the_errors_of_one_class(capsys: pytest.CaptureFixture[str]) -> None:
    """With `--class` the tables of errors and kinds of objects are those that JSON has for the class."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    car = msgspec.convert(document["diagnosis"], Diagnosis).classes[0].accuracy
    assert car is not None
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--class", "car"]) == 0
    printed = capsys.readouterr().out
    everything = printed.split("Mean errors of car, beside people's\n")[1].split("\n\n")[0].splitlines()[-1].split()
    mean = car.errors.mean
    assert everything[:3] == ["all", str(car.errors.true_positive_count), number(mean.center_m)]
    assert everything[-3:] == [number(mean.pitch_deg), number(mean.roll_deg), number(mean.size_percent)]
    assert "Car by kind of object" in printed


def test_errors_stand_beside_those_of_people(capsys: pytest.CaptureFixture[str]) -> None:
    """Both columns of people's errors are the paper's: 0.61 m and 1.78 degrees up to 10 m, 0.75 m and 2.09 over all."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    mean = msgspec.convert(document["diagnosis"], Diagnosis).accuracy.errors.mean
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred")]) == 0
    table = capsys.readouterr().out.split("Mean errors of all classes, beside people's\n")[1].split("\n\n")[0]
    header, _, *rows = [re.split(r" {2,}", line.strip()) for line in table.splitlines()]
    assert header[2:4] == ["centre m", "(people)"]
    assert header[7:9] == ["yaw deg", "(people)"]
    by_distance = {row[0]: row for row in rows}
    assert (by_distance["10"][3], by_distance["10"][8]) == ("0.61", "1.78")
    assert by_distance["all"][2:4] == [number(mean.center_m), "0.75"]
    assert by_distance["all"][7:9] == [number(mean.yaw_deg), "2.09"]


def test_a_class_without_ground_truth_cannot_be_shown(capsys: pytest.CaptureFixture[str]) -> None:
    """The message names the classes that can."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--class", "boat"]) == 2
    assert "no ground truth of the class 'boat'; choose one of car" in capsys.readouterr().err


def test_diagnose_adds_other_benchmarks_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    """Each of the four has its table; their signature is last, with the digests of the diagnosis."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--benchmarks"]) == 0
    printed = capsys.readouterr().out
    for name in ("KITTI", "nuScenes", "Waymo", "Argoverse 2"):
        assert f"As {name}" in printed
    of_diagnosis, of_comparison = [line for line in printed.splitlines() if "|evaluator:" in line]
    assert of_comparison == of_diagnosis.replace("cityscapes3d:1", "comparison")


def test_diagnose_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON holds the whole diagnosis, and the comparison metrics only when asked."""
    assert main(["diagnose", *ARGUMENTS, str(CASE / "pred"), "--json", "--benchmarks"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert msgspec.convert(document["diagnosis"], Diagnosis).classes[0].label == "car"
    comparison = msgspec.convert(document["comparison"], ComparisonMetrics)
    assert comparison.kitti.classes[0].label == "car"
    assert comparison.signature.predictions_sha256 == read_predictions(CASE / "pred", images=None).sha256


def test_compare_splits_the_difference(capsys: pytest.CaptureFixture[str], worse: Path) -> None:
    """Longer boxes lose points of size and nothing of yaw; second minus first is negative."""
    assert main(["compare", *ARGUMENTS, str(CASE / "pred"), str(worse), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    difference = msgspec.convert(document["difference"], Difference)
    assert difference.parts is not None
    assert difference.total is not None
    assert difference.total < 0
    assert difference.parts.size_sim < 0
    assert difference.parts.yaw_sim == pytest.approx(0.0, abs=1e-12)
    assert [signature.predictions_sha256 for signature in difference.signatures] == [
        read_predictions(folder, images=None).sha256 for folder in (CASE / "pred", worse)
    ]
    # Sixty images are too few for intervals.
    assert document["paired"]["means"]["mds"] is None


def test_compare_prints_a_table(capsys: pytest.CaptureFixture[str], worse: Path) -> None:
    """Below the classes and their sum stand what the bootstrap says, too few images here, and both signatures."""
    assert main(["compare", *ARGUMENTS, str(CASE / "pred"), str(worse)]) == 0
    printed = capsys.readouterr().out
    assert "points of mDS by class and part" in printed
    assert "\nall " in printed
    *_, chance, blank, first, second = printed.rstrip().splitlines()
    assert chance.startswith("Paired bootstrap over images: n/a")
    assert blank == ""
    assert first != second
    for signature in (first, second):
        assert re.fullmatch(r"cityscapes3d:1\|evaluator:[^|]+\|gt:[0-9a-f]{12}\|pred:[0-9a-f]{12}", signature)


def test_compare_explains_zeros_that_a_rule_makes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Trucks and buses are in one depth bin each; the second submission has no buses, and their 0 needs no word."""
    case = CASE.parent / "depth_bins"
    for path in sorted((case / "pred").glob("*.json")):
        document = json.loads(path.read_text())
        document["objects"] = [item for item in document["objects"] if item["label"] != "bus"]
        (tmp_path / path.name).write_text(json.dumps(document))
    assert main(["compare", "--gt", str(case / "gt"), str(case / "pred"), str(tmp_path)]) == 0
    said = [line.partition(": true positives")[0] for line in capsys.readouterr().out.splitlines() if "fewer" in line]
    assert said == ["In the first submission truck, bus", "In the second submission truck"]


def test_equal_submissions_do_not_differ(capsys: pytest.CaptureFixture[str]) -> None:
    """A submission compared with itself differs by exactly 0."""
    assert main(["compare", *ARGUMENTS, str(CASE / "pred"), str(CASE / "pred"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["difference"]["total"] == 0.0


@pytest.mark.parametrize("options", [[], ["--lenient"]], ids=["strict", "lenient"])
def test_compare_reads_classes_that_do_not_rank(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: list[str]
) -> None:
    """With every car a caravan the score of caravans is what that of cars was."""
    arguments = [*ARGUMENTS, str(CASE / "pred"), str(CASE / "pred"), "--labels", "car", "--json", *options]
    assert main(["compare", *arguments]) == 0
    of_cars = json.loads(capsys.readouterr().out)["difference"]["mds"]
    for part in ("gt", "pred"):
        (tmp_path / part).mkdir()
        for path in sorted((CASE / part).glob("*.json")):
            (tmp_path / part / path.name).write_text(path.read_text().replace('"car"', '"caravan"'))

    arguments = ["--gt", str(tmp_path / "gt"), *[str(tmp_path / "pred")] * 2, "--labels", "caravan", "--json", *options]
    assert main(["compare", *arguments]) == 0

    assert of_cars[0] > 0
    assert json.loads(capsys.readouterr().out)["difference"]["mds"] == of_cars


def test_a_path_that_is_not_there_is_wrong_usage(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The message names the path and what to give instead."""
    assert main(["diagnose", *ARGUMENTS, str(tmp_path / "missing.zip")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_predictions_with_errors_are_reported_and_not_scored(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A broken file ends with status 1 and a report that names it; `--lenient` is not needed to learn why."""
    shutil.copytree(CASE / "pred", tmp_path / "pred")
    broken = min((tmp_path / "pred").glob("*.json"))
    broken.write_text("{")
    for command in (["diagnose"], ["compare", str(CASE / "pred")]):
        assert main([*command, *ARGUMENTS, str(tmp_path / "pred")]) == 1
        streams = capsys.readouterr()
        assert broken.name in streams.err
        assert streams.out == ""


def test_undefined_numbers_are_written_as_such() -> None:
    """None is "n/a" in every notation, never 0."""
    assert {number(None), percent(None), points(None)} == {"n/a"}
    assert (number(1.236), percent(0.12345), points(0.01), points(-0.01)) == ("1.24", "12.35", "+1.00", "-1.00")


def test_tables_are_aligned() -> None:
    """The first column stands left, the others right, under the title."""
    lines = text_table("Title", ["name", "n"], [["a", "10"], ["long name", "5"]]).splitlines()
    assert lines == ["Title", "name        n", "-------------", "a          10", "long name   5"]
