"""The command `cs3d evaluate`, from its arguments to its output and exit status."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from client.main import main
from tests.results_comparison import differences

ORACLE = Path(__file__).parents[1] / "data" / "oracle"
CASES = sorted(ORACLE.iterdir())
TINY = ORACLE / "tiny_by_hand"
NOT_LOADED = {
    "asyncio", "http", "httpx", "ssl", "rich", "shapely",
    "server", "worker", "fastapi", "starlette", "uvicorn", "sqlalchemy", "celery", "redis", "pydantic", "jinja2",
}  # fmt: skip


def _arguments(case: Path) -> list[str]:
    parameters: dict[str, Any] = json.loads((case / "params.json").read_text())
    return ["evaluate", "--gt", str(case / "gt"), str(case / "pred"), *parameters["cli"]]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
@pytest.mark.parametrize("lenient", [False, True], ids=["strict", "lenient"])
def test_recorded_cases_come_out_of_the_command(case: Path, packed: bool, lenient: bool, tmp_path: Path) -> None:  # noqa: FBT001 - pytest passes parameters by name
    """Folders and zips, strict and lenient: `--format cityscapes -o` writes the reference's results.json, and a signature."""
    gt, predictions = case / "gt", case / "pred"
    if packed:
        gt, predictions = (Path(shutil.make_archive(str(tmp_path / p.name), "zip", p)) for p in (gt, predictions))
    parameters: dict[str, Any] = json.loads((case / "params.json").read_text())
    output = tmp_path / "results.json"
    arguments = ["evaluate", "--gt", str(gt), str(predictions), *parameters["cli"], "--format", "cityscapes"]

    status = main([*arguments, *(["--lenient"] if lenient else []), "-o", str(output)])

    assert status == 0
    expected = json.loads((case / "expected.json").read_text())
    found = json.loads(output.read_text())
    assert found.pop("signature").startswith("cityscapes3d:1")
    assert list(differences(found, expected)) == []


def test_the_table_shows_every_class_in_percent_and_the_signature(capsys: pytest.CaptureFixture[str]) -> None:
    """Default output: a row for each class, n/a where undefined, means, and the signature on the last line."""
    assert main(_arguments(TINY)) == 0

    lines = capsys.readouterr().out.splitlines()
    # car: AP 5/6, DS .8278 (recorded); truck has no ground truth; mDS .4139 is the mean of car .8278 and bicycle 0.
    assert lines[2].split() == ["car", "3", "83.33", "99.90", "100.00", "100.00", "97.46", "82.78", "0.00"]
    assert lines[3].split() == ["truck", "0", *["n/a"] * 7]
    assert lines[9].split() == ["mean", "5", "66.67", "49.95", "50.00", "50.00", "48.73", "41.39"]
    assert lines[-1].startswith("mDS 41.39  cityscapes3d:1|evaluator:1|gt:")


@pytest.mark.parametrize(
    ("case", "options", "zeroed"),
    [
        # One truck, and two buses in one bin; ten cars in as many bins as there are.
        ("depth_bins", [], ["truck, bus"]),
        # Every class that is found has true positives in two bins.
        ("realistic60", [], []),
        # The protocol of the paper averages over all bins, filled or not: one bin is not zero.
        ("depth_bins", ["--protocol", "paper"], []),
    ],
)
def test_a_zero_that_a_rule_makes_is_explained(
    case: str, options: list[str], zeroed: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Where true positives fill fewer than two depth bins the table says why AP stands beside zeros."""
    assert main(["evaluate", "--gt", str(ORACLE / case / "gt"), str(ORACLE / case / "pred"), *options]) == 0

    said = [line.split(":")[0] for line in capsys.readouterr().out.splitlines() if "fewer than two depth bins" in line]
    assert said == zeroed


def test_json_has_everything_and_writes_undefined_as_null(capsys: pytest.CaptureFixture[str]) -> None:
    """`--format json` gives our own document, with null where there is nothing to measure on."""
    assert main([*_arguments(TINY), "--format", "json"]) == 0

    document = json.loads(capsys.readouterr().out)
    assert document["mds"] == pytest.approx(0.41391280350754744, abs=1e-12)
    assert document["classes"][1]["ap"] is None
    assert document["signature"]["protocol"]["name"] == "cityscapes3d"
    assert document["signature_text"].startswith("cityscapes3d:1|")


def test_changed_parameters_stand_in_the_signature(capsys: pytest.CaptureFixture[str]) -> None:
    """A number made with other parameters cannot be mistaken for the published protocol's."""
    assert main([*_arguments(TINY), "--min-iou", "0.5", "--labels", "car", "bicycle"]) == 0

    assert "cityscapes3d:1+labels=car,bicycle+min_iou=0.5|" in capsys.readouterr().out


def test_problems_in_predictions_end_with_a_report_and_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    """Predictions for other images are refused, on stderr, with file names and fixes."""
    status = main(["evaluate", "--gt", str(TINY / "gt"), str(ORACLE / "realistic60" / "pred")])

    printed = capsys.readouterr()
    assert (status, printed.out) == (1, "")
    assert "missing_image, 2x" in printed.err
    assert "fix: " in printed.err


def test_lenient_takes_missing_images_as_empty_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """The same predictions are scored leniently: nothing found, so every defined score is 0."""
    status = main(["evaluate", "--lenient", "--gt", str(TINY / "gt"), str(ORACLE / "realistic60" / "pred")])

    printed = capsys.readouterr()
    assert status == 0
    assert "mDS 0.00" in printed.out
    assert "bonn_000000_000019" in printed.err


def test_broken_ground_truth_lists_every_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All unusable files are named at once, with the place inside them."""
    (tmp_path / "a_000000_000001_gtBbox3d.json").write_text('{"sensor": 1}')
    (tmp_path / "b_000000_000001_gtBbox3d.json").write_text("{")

    assert main(["evaluate", "--gt", str(tmp_path), str(TINY / "pred")]) == 1

    printed = capsys.readouterr().err
    assert "a_000000_000001_gtBbox3d.json" in printed
    assert "$.sensor" in printed
    assert "b_000000_000001_gtBbox3d.json" in printed


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["--min-iou", "-0.1"], "--min-iou"),
        (["--min-iou", "nan"], "--min-iou"),
        (["--max-depth", "0"], "--max-depth"),
        (["--step-size", "0"], "--step-size"),
        (["--max-depth", "5000000000"], "--step-size"),
        (["--cw", "nan"], "--cw"),
        (["-o", "/nowhere/results.json"], "Cannot write"),
    ],
)
def test_meaningless_parameters_are_wrong_usage(
    arguments: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 2 and a message that names the option; the reference never ends on a negative minimum IoU."""
    assert main([*_arguments(TINY), *arguments]) == 2

    assert hint in capsys.readouterr().err


def test_a_path_that_does_not_exist_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and the path."""
    assert main(["evaluate", "--gt", str(TINY / "gt"), "nowhere.zip"]) == 2

    assert "nowhere.zip does not exist" in capsys.readouterr().err


def test_a_name_no_file_can_have_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever the file system refuses ends with status 2 and its own words, not with a traceback."""
    assert main(["evaluate", "--gt", str(TINY / "gt"), "a" * 5000]) == 2

    assert "File name too long" in capsys.readouterr().err


@pytest.mark.parametrize(("closed", "status"), [("pipe", 0), ("/dev/full", 2)])
def test_output_nobody_takes_ends_without_a_traceback(closed: str, status: int) -> None:
    """A closed pipe is no error; a full disk is one, and says so."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing) if closed == "pipe" else open(closed, "w") as output:  # noqa: PTH123 - like a descriptor
        command = [sys.executable, "-m", "client.main", *_arguments(TINY)]
        ended = subprocess.run(command, stdout=output, stderr=subprocess.PIPE, text=True, check=False)
    if closed != "pipe":
        os.close(writing)

    assert ended.returncode == status
    assert "Traceback" not in ended.stderr
    assert ("No space left" in ended.stderr) == (status == 2)


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
def test_nothing_web_like_is_loaded(packed: bool, tmp_path: Path) -> None:  # noqa: FBT001 - pytest passes parameters by name
    """Evaluating loads no network, no server and none of what only other commands need: it would cost the start."""
    arguments = _arguments(TINY)
    if packed:
        arguments[3] = shutil.make_archive(str(tmp_path / "pred"), "zip", TINY / "pred")
    script = (
        "import sys; from client.main import main; status = main(sys.argv[1:]); "
        "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr); sys.exit(status)"
    )

    ended = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)

    assert ended.returncode == 0
    loaded = set(ended.stderr.split())
    assert {"client", "evaluator", "numpy"} <= loaded
    assert loaded & NOT_LOADED == set()


def test_missing_arguments_are_wrong_usage() -> None:
    """Argparse ends the process with status 2 itself."""
    with pytest.raises(SystemExit) as end:
        main(["evaluate"])

    assert end.value.code == 2
