"""Confidence intervals on the command line, on an imaginary benchmark large enough for some."""

import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from client.main import main
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip

IMAGES = 500


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ground truth with two methods, as zips."""
    folder = tmp_path_factory.mktemp("benchmark")
    files = synthesize_ground_truth(IMAGES, seed=1)
    write_zip(files, folder / "gt.zip")
    for quality, name in ((QUALITIES[0], "good.zip"), (QUALITIES[-1], "bad.zip")):
        write_zip(synthesize_predictions(files, quality, 2, 20), folder / name)
    return folder


def _evaluate(benchmark: Path, *options: str) -> int:
    return main(["evaluate", "--gt", str(benchmark / "gt.zip"), str(benchmark / "good.zip"), *options])


def test_every_row_is_followed_by_its_intervals(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The interval of a car's AP holds the AP above it; YawSim needs more boxes than these images have."""
    assert _evaluate(benchmark, "--intervals") == 0

    lines = capsys.readouterr().out.splitlines()
    ap, bounds = float(lines[2].split()[2]), lines[3].split()
    lower, upper = (float(bound) for bound in bounds[0].split("-"))
    assert lines[2].startswith("car")
    assert lower <= ap <= upper
    assert len(bounds) == 6
    assert lines[-3].startswith("Second lines: 95 % confidence intervals, bca, 1000 resamples of the images")
    assert lines[-1].startswith("mDS ")


def test_json_holds_the_intervals_of_depth_bins_too(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Estimates are the scores of the same document; without the option there is nothing of it."""
    assert _evaluate(benchmark, "--intervals", "--format", "json") == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert _evaluate(benchmark, "--format", "json") == 0

    car, uncertainty = document["classes"][0], document["uncertainty"]
    assert uncertainty["level"] == 0.95
    assert uncertainty["classes"]["car"]["ap"]["estimate"] == pytest.approx(car["ap"], abs=1e-12)
    bins = uncertainty["depth_bins"]["car"]
    assert len(bins) == len(car["depth_bins"]) == 20
    assert any(part["ap"] for part in bins)
    assert "uncertainty" not in json.loads(capsys.readouterr().out)


def test_the_protocol_paper_has_intervals(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its AP comes from every score, its intervals, too."""
    assert _evaluate(benchmark, "--intervals", "--format", "json", "--protocol", "paper") == 0

    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    interval = document["uncertainty"]["classes"]["car"]["ap"]
    assert interval["estimate"] == pytest.approx(document["classes"][0]["ap"], abs=1e-12)
    assert interval["lower"] < interval["estimate"] < interval["upper"]


def test_the_table_says_why_there_is_no_interval(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Under the protocol `paper` it is the protocol, too, however many boxes there are."""
    for protocol, reason in (
        ("cityscapes3d", "n/a: too few images or boxes."),
        ("paper", "n/a: too few images or boxes, and all but AP by the protocol paper."),
    ):
        assert _evaluate(benchmark, "--intervals", "--protocol", protocol, "--resamples", "200") == 0
        assert capsys.readouterr().out.splitlines()[-3].endswith(reason)


def test_the_reference_format_has_no_place_for_intervals(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Asking for both is wrong usage."""
    assert _evaluate(benchmark, "--intervals", "--format", "cityscapes") == 2
    assert "no place for --intervals" in capsys.readouterr().err


def test_intervals_are_of_a_hundred_depth_bins_at_most(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """101 bins of 1 m are too many with intervals, which keep each of them a thousand times, and fine without."""
    bins = ("--max-depth", "101", "--step-size", "1")

    assert _evaluate(benchmark, *bins, "--intervals") == 2
    assert "must not exceed 100 with --intervals" in capsys.readouterr().err
    assert _evaluate(benchmark, *bins) == 0


def _in_sequences(benchmark: Path, folder: Path, frames: int) -> Path:
    """Rename the images so that so many after each other are frames of one sequence."""
    for name in ("gt.zip", "good.zip", "bad.zip"):
        with zipfile.ZipFile(benchmark / name) as archive:
            files = {own: archive.read(own) for own in sorted(archive.namelist())}
        write_zip(
            {
                f"city_{number // frames:06d}_{number % frames:06d}_{own.rpartition('_')[2]}": data
                for number, (own, data) in enumerate(files.items())
            },
            folder / name,
        )
    return folder


def test_whole_sequences_can_be_drawn(benchmark: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where each image is a sequence it is the same; with two frames in each, 250 sequences are too few."""
    compared = ["compare", "--labels", "car", "--json", "--gt"]
    said = {}
    for frames, unit in ((1, "image"), (1, "sequence"), (2, "sequence"), (2, "city")):
        folder = tmp_path / f"{frames} {unit}"
        folder.mkdir()
        _in_sequences(benchmark, folder, frames)
        assert _evaluate(folder, "--intervals", "--unit", unit, "--format", "json", "--resamples", "200") == 0
        uncertainty = json.loads(capsys.readouterr().out)["uncertainty"]
        assert uncertainty["unit"] == unit
        assert (
            main(
                [
                    *compared,
                    str(folder / "gt.zip"),
                    *(str(folder / f"{name}.zip") for name in ("good", "bad")),
                    "--unit",
                    unit,
                    "--resamples",
                    "200",
                ]
            )
            == 0
        )
        comparison = json.loads(capsys.readouterr().out)
        standard = {"resamples": 200, "seed": 20200614, "level": 0.95}
        assert {name: comparison["paired"][name] for name in ("unit", *standard)} == {"unit": unit, **standard}
        assert comparison["paired"]["signatures"] == comparison["difference"]["signatures"][::-1]
        said[frames, unit] = uncertainty["classes"]["car"]["ap"], comparison["paired"]["means"]["mds"]

    assert None not in said[1, "image"]
    assert said[1, "image"] == said[1, "sequence"]
    assert said[2, "sequence"] == said[2, "city"] == (None, None)


def test_what_too_little_is_known_for_is_given_on_request(
    benchmark: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every interval of every metric, over 250 sequences; each says that nobody vouches for it, in text and JSON."""
    _in_sequences(benchmark, tmp_path, 2)
    asked = ("--unit", "sequence", "--unproven", "--resamples", "200")
    assert _evaluate(tmp_path, "--intervals", *asked, "--format", "json") == 0
    document = json.loads(capsys.readouterr().out)
    means, classes = document["uncertainty"]["means"], document["uncertainty"]["classes"]
    given = [*means.values(), *(one for of in classes.values() for one in of.values())]
    assert all(one["is_proven"] is False and one["lower"] <= one["upper"] for one in given)
    bins = document["uncertainty"]["depth_bins"]["car"]
    assert all(one is None or not one["is_proven"] for of in bins for one in of.values())
    assert means["mds"]["lower"] < document["mds"] < means["mds"]["upper"]

    assert _evaluate(tmp_path, "--intervals", *asked) == 0
    text = capsys.readouterr().out
    assert "n/a" not in text.split("Second lines")[0]
    assert "resamples of the sequences; ?: unproven, too few sequences or boxes; n/a: undefined." in text
    assert f"{100 * means['mds']['lower']:.1f}-{100 * means['mds']['upper']:.1f}?" in text

    sides = [str(tmp_path / name) for name in ("gt.zip", "good.zip", "bad.zip")]
    assert main(["compare", "--gt", *sides, *asked]) == 0
    assert "unproven: too few sequences or boxes of a class" in capsys.readouterr().out


def test_what_is_proven_stays_what_it_is_among_the_unproven(
    benchmark: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Asking for more changes nothing of what is given anyway."""
    assert _evaluate(benchmark, "--intervals", "--resamples", "200", "--format", "json") == 0
    few = json.loads(capsys.readouterr().out)["uncertainty"]["classes"]["car"]
    assert _evaluate(benchmark, "--intervals", "--resamples", "200", "--unproven", "--format", "json") == 0
    all_of_them = json.loads(capsys.readouterr().out)["uncertainty"]["classes"]["car"]
    assert few["ap"] is not None
    assert few["yaw_sim"] is None
    assert all_of_them["yaw_sim"]["is_proven"] is False
    assert {name: one for name, one in all_of_them.items() if "is_proven" not in one} == {
        name: one for name, one in few.items() if one is not None
    }


def test_another_draw_level_and_method(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are the library's arguments, and are said with the numbers; a wider level is wider."""
    widths = []
    for level in ("0.5", "0.95"):
        options = ("--resamples", "200", "--seed", "7", "--level", level, "--method", "percentile")
        assert _evaluate(benchmark, "--intervals", *options, "--format", "json") == 0
        uncertainty = json.loads(capsys.readouterr().out)["uncertainty"]
        said = {name: uncertainty[name] for name in ("resamples", "seed", "level", "method")}
        assert said == {"resamples": 200, "seed": 7, "level": float(level), "method": "percentile"}
        interval = uncertainty["classes"]["car"]["ap"]
        widths.append(interval["upper"] - interval["lower"])
    assert widths[0] < widths[1]
    sides = [str(benchmark / name) for name in ("gt.zip", "good.zip", "bad.zip")]
    assert main(["compare", "--gt", *sides, "--labels", "car", "--level", "0.9", "--resamples", "200"]) == 0
    assert "90 % interval [-" in capsys.readouterr().out


def test_every_unit_of_one_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One city is the same however often it is drawn; the message says so, also where unproven intervals will do."""
    files = synthesize_ground_truth(2, seed=1)
    write_zip(
        {f"city_000000_{number:06d}_x.json": data for number, data in enumerate(files.values())}, tmp_path / "gt.zip"
    )
    predictions = synthesize_predictions(files, QUALITIES[0], 2, 20)
    write_zip(
        {f"city_000000_{number:06d}_x.json": data for number, data in enumerate(predictions.values())},
        tmp_path / "good.zip",
    )
    assert _evaluate(tmp_path, "--intervals", "--unproven", "--unit", "city") == 2
    assert "there is 1. Draw smaller units" in capsys.readouterr().err


def test_texts_name_what_is_drawn(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In both tables, and why there is nothing."""
    assert _evaluate(benchmark, "--intervals", "--unit", "city") == 0
    assert "1000 resamples of the cities; n/a: too few cities or boxes." in capsys.readouterr().out

    sides = [str(benchmark / name) for name in ("gt.zip", "good.zip", "bad.zip")]
    assert main(["compare", "--gt", *sides, "--unit", "city"]) == 0
    assert "Paired bootstrap over cities: n/a, there are too few cities or boxes" in capsys.readouterr().out


def test_a_unit_without_intervals_is_wrong_usage(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing would be drawn."""
    assert _evaluate(benchmark, "--unit", "sequence") == 2
    assert "add --intervals" in capsys.readouterr().err


def test_compare_prints_difference_interval_and_p_value(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of cars, of which there are enough; the second method is worse, which cannot be chance."""
    arguments = ["compare", "--gt", str(benchmark / "gt.zip"), str(benchmark / "good.zip"), str(benchmark / "bad.zip")]
    assert main([*arguments, "--labels", "car"]) == 0

    said = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("Paired bootstrap"))
    # p = 2 (1 + 0) / 1001: no resample favours the second.
    assert "95 % interval [-" in said
    assert said.endswith("p = 0.002")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["evaluate", "--intervals"], "n/a: too few images"),
        (["compare", "{folder}/pred"], "n/a, there are too few images"),
    ],
)
def test_one_image_has_scores_without_intervals(
    command: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """There is nothing to resample, but the scores are printed."""
    files = synthesize_ground_truth(1, seed=1)
    for name, content in (("gt", files), ("pred", synthesize_predictions(files, QUALITIES[0], 2, 20))):
        (tmp_path / name).mkdir()
        for file, data in content.items():
            (tmp_path / name / file).write_bytes(data)

    arguments = [part.format(folder=tmp_path) for part in command]
    assert main([*arguments, "--gt", str(tmp_path / "gt"), str(tmp_path / "pred")]) == 0

    printed = capsys.readouterr().out
    assert said in printed
    assert "mDS " in printed


def test_too_many_labels_are_wrong_usage(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of 127 classes the data set has eight, so 120 others are one too many."""
    labels = [str(number) for number in range(120)]

    assert _evaluate(benchmark, "--labels", *labels) == 2
    assert "name 119 at most" in capsys.readouterr().err
    assert _evaluate(benchmark, "--labels", *labels[1:]) == 0


@pytest.mark.parametrize("command", [["evaluate"], ["compare", "SECOND"]])
def test_a_label_nobody_has_is_noted(benchmark: Path, capsys: pytest.CaptureFixture[str], command: list[str]) -> None:
    """`Car` is not `car`: the scores are n/a, and a note says why; no note on a label that is there."""
    paths = [str(benchmark / "good.zip")] * len(command)
    assert main([command[0], "--gt", str(benchmark / "gt.zip"), *paths, "--labels", "Car", "car"]) == 0

    notes = [line for line in capsys.readouterr().err.splitlines() if "has the label" in line]
    note = "note: no box in the ground truth, nor in the predictions outside ignore regions, has the label 'Car'."
    assert notes == [note] * len(command)


def test_no_interval_is_given_that_resamples_do_not_bear(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the detection scores of the protocol `paper` there is none on request either, and the texts say why."""
    assert (
        _evaluate(
            benchmark, "--intervals", "--unproven", "--protocol", "paper", "--format", "json", "--resamples", "200"
        )
        == 0
    )
    uncertainty = json.loads(capsys.readouterr().out)["uncertainty"]
    assert {name for name, one in uncertainty["means"].items() if one} == {"map"}
    sides = [str(benchmark / name) for name in ("gt.zip", "good.zip", "bad.zip")]
    assert main(["compare", "--gt", *sides, "--unproven", "--protocol", "paper", "--resamples", "200"]) == 0
    printed = capsys.readouterr().out
    assert "n/a, resamples do not scatter about the mDS of the protocol paper." in printed
    assert printed.splitlines()[-1].startswith("paper:1|")


def test_rules_can_be_changed_in_every_offline_command(benchmark: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The signature tells what was changed; a caravan can be diagnosed."""
    rules = ["--min-iou", "0.5", "--modal", "--max-depth", "60", "--cw", "0.3"]
    said = "+min_iou=0.5+max_depth_m=60+working_point=0.3+modal=True|"
    sides = {name: str(benchmark / f"{name}.zip") for name in ("gt", "good", "bad")}
    assert main(["compare", "--gt", sides["gt"], sides["good"], sides["bad"], *rules]) == 0
    assert capsys.readouterr().out.count(f"cityscapes3d:1{said}") == 2
    assert main(["diagnose", "--gt", sides["gt"], sides["good"], "--labels", "car", "caravan", *rules]) == 0
    printed = capsys.readouterr().out
    assert f"cityscapes3d:1+labels=car,caravan{said}" in printed
    assert "\ncaravan " in printed
    assert main(["diagnose", "--gt", sides["gt"], sides["good"], "--min-iou", "-1"]) == 2
    assert "--min-iou" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--resamples", "0"], "--resamples must be from 200 to 10000 at --level 0.95."),
        (["--resamples", "199"], "from 200 to"),
        (["--resamples", "10001"], "to 10000 at"),
        (["--level", "0.99", "--resamples", "999"], "from 1000 to"),
        (["--level", "0.9999"], "--level must be at most 0.999"),
        (["--level", "nan"], "must lie between 0 and 1"),
        (["--level", "1"], "must lie between 0 and 1"),
        (["--seed", "-1"], "whole number of 0 or more"),
    ],
)
def test_draws_that_say_nothing_are_wrong_usage(
    benchmark: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    """Too few resamples for the level, more than fit into memory, or no level or seed at all."""
    assert _evaluate(benchmark, "--intervals", *options) == 2
    assert said in capsys.readouterr().err
    sides = [str(benchmark / name) for name in ("gt.zip", "good.zip", "bad.zip")]
    assert main(["compare", "--gt", *sides, "--labels", "car", *options]) == 2
    assert said in capsys.readouterr().err
