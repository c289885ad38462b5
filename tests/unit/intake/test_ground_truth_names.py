"""Which files of a folder or zip are ground truth: nothing that looks like it is left out in silence."""

import json
import os
import shutil
from pathlib import Path

import pytest

from evaluator.ground_truth import GroundTruthError, ground_truth_files, read_ground_truth

CASE = Path(__file__).parents[2] / "data" / "oracle" / "tiny_by_hand" / "gt"
NAME = "bonn_000000_000019_gtBbox3d.json"


@pytest.fixture
def ground_truth(tmp_path: Path) -> Path:
    """Give a folder with one image's ground truth."""
    folder = tmp_path / "gt"
    folder.mkdir()
    shutil.copyfile(next(CASE.glob("*.json")), folder / NAME)
    return folder


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    "odd", ["ulm_000000_000019_gtBbox3d.JSON", "ulm_000000_000019_gtBbox3d.json.bak", "sub/x_gtbbox3d.jsn", "a.Json"]
)
def test_what_looks_like_ground_truth_is_not_passed_over(ground_truth: Path, odd: str, *, packed: bool) -> None:
    """A suffix in capitals, a backup copy or a slip in the suffix is an error that names the file."""
    (ground_truth / odd).parent.mkdir(exist_ok=True)
    shutil.copyfile(ground_truth / NAME, ground_truth / odd)
    source = Path(shutil.make_archive(str(ground_truth), "zip", ground_truth)) if packed else ground_truth
    with pytest.raises(GroundTruthError, match="has 1 problem:") as error:
        read_ground_truth(source)
    assert f"{odd}: name it" in str(error.value)


def test_other_files_beside_it_do_not_matter(ground_truth: Path) -> None:
    """Results, macOS's attributes, texts and pictures are no ground truth and are passed over."""
    for name in ("results.json", f"._{NAME}", "README.md", "bonn_000000_000019_leftImg8bit.png"):
        (ground_truth / name).write_text("{}")
    assert read_ground_truth(ground_truth).images == ("bonn_000000_000019",)


def test_a_pipe_is_named_and_not_waited_for(ground_truth: Path) -> None:
    """Opening it would wait for somebody to write into it."""
    os.mkfifo(ground_truth / "ulm_000000_000019_gtBbox3d.json")
    with pytest.raises(GroundTruthError, match=r"ulm_000000_000019_gtBbox3d[.]json: no regular file"):
        read_ground_truth(ground_truth)


def test_the_files_that_were_read_are_those_that_are_kept(ground_truth: Path) -> None:
    """What lies beside ground truth is no part of it, so the same ground truth gives the same bytes to keep."""
    (ground_truth / "sub").mkdir()
    (ground_truth / NAME).rename(ground_truth / "sub" / NAME)
    before = ground_truth_files(ground_truth)
    for name in ("results.json", f"._{NAME}", "sub/results.json"):
        (ground_truth / name).write_text("{}")
    assert ground_truth_files(ground_truth) == before == {NAME: (ground_truth / "sub" / NAME).read_bytes()}


def test_a_linked_folder_is_named(ground_truth: Path, tmp_path: Path) -> None:
    """A link to a folder, which is not followed, is an error instead of a missing part of the data set."""
    (tmp_path / "elsewhere").mkdir()
    (ground_truth / "val").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(GroundTruthError, match="val: a link to a folder"):
        read_ground_truth(ground_truth)


def test_a_folder_that_cannot_be_listed_is_said(ground_truth: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the right to look into a sub-folder the rest is not taken for the whole."""
    hidden = ground_truth / "hidden"
    hidden.mkdir()
    real = os.scandir

    def scandir(path: str) -> object:
        if Path(path) == hidden:  # root may list anything, so the system's refusal is imitated
            raise PermissionError(13, "Permission denied", path)
        return real(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with pytest.raises(GroundTruthError, match="check its permissions"):
        read_ground_truth(ground_truth)


def test_one_problem_is_one_problem(ground_truth: Path) -> None:
    """The message counts in words as people do."""
    document = json.loads((ground_truth / NAME).read_text())
    document["sensor"]["fx"] = 0
    (ground_truth / NAME).write_text(json.dumps(document))
    with pytest.raises(GroundTruthError, match="has 1 problem:"):
        read_ground_truth(ground_truth)
