"""Two processes give what one gives, bit for bit, and the same report."""

import faulthandler
import json
import os
import subprocess
import sys
import time
import zipfile
from multiprocessing import active_children, get_context
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

import pytest

from evaluator import parallel, turns
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.parallel import TwoProcesses, evaluate_file
from evaluator.parts import ground_truth_of
from evaluator.protocol import CITYSCAPES3D
from evaluator.strict import StrictReading

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"


@pytest.fixture(scope="module")
def ground_truth() -> GroundTruth:
    """Sixty images."""
    return read_ground_truth(CASE / "gt")


@pytest.fixture(autouse=True)
def _sixty_images_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two processes work on them, though one would be as fast."""
    monkeypatch.setattr(parallel, "FEWEST_IMAGES", 60)


def _zip(folder: Path, changes: dict[str, bytes], name: str = "predictions.zip") -> Path:
    """Pack the case's predictions with some files replaced or added."""
    path = folder / name
    files = {file.name: file.read_bytes() for file in (CASE / "pred").iterdir()} | changes
    with zipfile.ZipFile(path, "w") as archive:
        for file, data in sorted(files.items()):
            archive.writestr(zipfile.ZipInfo(file), data)  # of 1980: equal bytes whenever it is written
    return path


def test_halves_give_the_same_bits(ground_truth: GroundTruth) -> None:
    """Statistics and scores of a folder do not depend on how the images were split."""
    one = evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=False)
    two = evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=True)

    assert one.statistics is not None
    assert two.statistics is not None
    assert one.statistics.to_bytes() == two.statistics.to_bytes()
    assert (one.scores, one.report, one.predictions_sha256) == (two.scores, two.report, two.predictions_sha256)


@pytest.mark.parametrize("images", [1, 7, 60, 1000])
def test_whoever_reads_what_the_bits_are_the_same(
    ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch, images: int
) -> None:
    """Image by image, or all at one turn, which leaves nothing to the other process; file after file."""
    one = evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=False)
    assert one.statistics is not None
    monkeypatch.setattr(turns, "_TURN_IMAGES", images)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        for _ in range(3):
            two = both.evaluate(CASE / "pred")
            assert two.statistics is not None
            assert one.statistics.to_bytes() == two.statistics.to_bytes()
            assert (one.scores, one.report) == (two.scores, two.report)
        assert both.is_split


@pytest.mark.parametrize("slow", ["first", "second"])
def test_a_slow_process_leaves_the_work_to_the_other(
    ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch, slow: str
) -> None:
    """While one process waits a tenth of a second for each file, the other one reads nearly all of them."""
    read, here = StrictReading._read_bytes, os.getpid()

    def slowed(reading: StrictReading, number: int) -> bytes | None:
        if (os.getpid() == here) == (slow == "first"):
            time.sleep(0.1)
        counts[os.getpid() == here] += 1
        return read(reading, number)

    counts = {True: 0, False: 0}  # of the first process; what the second one counts stays there
    monkeypatch.setattr(turns, "_TURN_IMAGES", 1)
    monkeypatch.setattr(StrictReading, "_read_bytes", slowed)
    two = evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=True)
    assert two.scores is not None
    assert counts[True] < 20 if slow == "first" else counts[True] > 40


@pytest.mark.parametrize(("fewest", "processes"), [(60, 1), (61, 0)])
def test_few_images_need_no_second_process(
    ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch, fewest: int, processes: int
) -> None:
    """Where it does not pay, none is started."""
    started: list[str] = []

    def counting(method: str) -> BaseContext:
        started.append(method)
        return get_context(method)

    monkeypatch.setattr(parallel, "get_context", counting)
    monkeypatch.setattr(parallel, "FEWEST_IMAGES", fewest)

    evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=True)

    assert len(started) == processes


def test_one_second_process_serves_many_files(ground_truth: GroundTruth, tmp_path: Path) -> None:
    """Clean files, broken ones in either half and one that is no archive, in any order, come out as one by one."""
    names = sorted(path.name for path in (CASE / "pred").iterdir())
    broken = [{name: b'{"objects": [{}]}'} for name in (names[0], names[-1])]
    changes = [{}, broken[0], {names[3]: b'{"objects": []}'}, broken[1], {}]
    sources = [_zip(tmp_path, change, f"{number}.zip") for number, change in enumerate(changes)]
    sources.insert(2, Path(__file__))

    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        found = [both.evaluate(source) for source in sources]
        assert both.is_split
    assert not both.is_split

    expected = [evaluate_file(source, ground_truth, CITYSCAPES3D, split=False) for source in sources]
    assert [one.scores is None for one in found] == [False, True, True, False, True, False]
    assert [(one.scores, one.report, one.predictions_sha256) for one in found] == [
        (one.scores, one.report, one.predictions_sha256) for one in expected
    ]


def test_a_relative_path_means_the_same_to_both(
    ground_truth: GroundTruth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It starts where the first process is at the call, though a file of this name lies where both were at the start."""
    last = max(path.name for path in (CASE / "pred").iterdir())
    there, here = tmp_path / "there", tmp_path / "here"
    for folder, changes in ((there, {last: b'{"objects": []}'}), (here, {})):
        folder.mkdir()
        _zip(folder, changes, "p.zip")
    monkeypatch.chdir(there)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        monkeypatch.chdir(here)
        found = both.evaluate(Path("p.zip"))
        assert both.is_split
    assert found.scores == evaluate_file(here / "p.zip", ground_truth, CITYSCAPES3D, split=False).scores


def test_the_death_of_the_second_process_costs_time_only(ground_truth: GroundTruth) -> None:
    """Killed between two files, it is done without: the same result, from then on by one process."""
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        first = both.evaluate(CASE / "pred")
        (child,) = active_children()
        child.kill()
        second = both.evaluate(CASE / "pred")
        assert not both.is_split
        assert (first.scores, first.report) == (second.scores, second.report)


@pytest.mark.parametrize("step", ["_read_part", "_match", "_report"])
def test_it_may_die_at_any_step(ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    """Whatever it had answered before its end: the same result, by one process."""
    one = evaluate_file(CASE / "pred", ground_truth, CITYSCAPES3D, split=False)
    take_the_step, here = getattr(parallel, step), os.getpid()

    def die(*args: Any, **options: Any) -> Any:
        if os.getpid() != here:
            os._exit(1)
        return take_the_step(*args, **options)

    monkeypatch.setattr(parallel, step, die)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        two = both.evaluate(CASE / "pred")
        assert not both.is_split
    assert (one.scores, one.report) == (two.scores, two.report)


def test_the_second_process_ends_with_the_first() -> None:
    """Whoever is killed leaves no process behind."""
    program = (
        "import time\n"
        "from pathlib import Path\n"
        "from evaluator import parallel\n"
        "from evaluator.ground_truth import read_ground_truth\n"
        "from evaluator.protocol import CITYSCAPES3D\n"
        "parallel.FEWEST_IMAGES = 60\n"
        f"both = parallel.TwoProcesses(read_ground_truth(Path({str(CASE / 'gt')!r})), CITYSCAPES3D)\n"
        "print('both run', flush=True)\n"
        "time.sleep(600)\n"
    )
    first = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    assert first.stdout.readline() == "both run\n"

    first.kill()

    # The output has an end when both have closed it.
    assert first.communicate(timeout=60)[0] == ""


def test_where_no_process_can_be_started_one_does_it(
    ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that refuses to fork costs time only."""

    def refused() -> int:
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", refused)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        assert not both.is_split
        assert both.evaluate(CASE / "pred").scores is not None


def test_a_program_that_ignores_sigterm_still_ends() -> None:
    """At its end multiprocessing sends SIGTERM to what it started, and waits."""
    program = (
        "import signal\n"
        "from pathlib import Path\n"
        "from evaluator import parallel\n"
        "from evaluator.ground_truth import read_ground_truth\n"
        "from evaluator.protocol import CITYSCAPES3D\n"
        "parallel.FEWEST_IMAGES = 60\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        f"both = parallel.TwoProcesses(read_ground_truth(Path({str(CASE / 'gt')!r})), CITYSCAPES3D)\n"
        "assert both.is_split\n"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0


def test_an_exception_leaves_no_half_answer_behind(ground_truth: GroundTruth, monkeypatch: pytest.MonkeyPatch) -> None:
    """After an interruption the second process, which may be about to answer, is not asked again."""
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        with monkeypatch.context() as patch:
            patch.setattr(parallel, "open_source", _interrupted)
            with pytest.raises(KeyboardInterrupt):
                both.evaluate(CASE / "pred")
        assert not both.is_split
        assert both.evaluate(CASE / "pred").scores is not None


def _interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_boxes_left_out_are_counted_over_both_halves(ground_truth: GroundTruth, tmp_path: Path) -> None:
    """Trailers in the first and the last image and a caravan in the last give one note that counts three.

    Caravans come first, as in one process, though the first half has none.
    """
    names = sorted(path.name for path in (CASE / "pred").iterdir())
    box = json.loads((CASE / "pred" / names[0]).read_bytes())["objects"][0]
    trailer, caravan = ({**box, "label": label} for label in ("trailer", "caravan"))
    changes = {
        names[0]: json.dumps({"objects": [trailer]}).encode(),
        names[-1]: json.dumps({"objects": [trailer, caravan]}).encode(),
    }

    one, two = (
        evaluate_file(_zip(tmp_path, changes), ground_truth, CITYSCAPES3D, split=split) for split in (False, True)
    )

    assert [(group.code, group.count) for group in two.report.groups] == [("unevaluated_label", 3)]
    assert [problem.found for problem in two.report.groups[0].problems] == ["caravan", "trailer"]
    assert (one.scores, one.report) == (two.scores, two.report)


def test_an_error_in_the_second_half_gives_the_whole_report(ground_truth: GroundTruth, tmp_path: Path) -> None:
    """A broken last file refuses the submission with the same report as in one process."""
    last = max(path.name for path in (CASE / "pred").iterdir())
    source = _zip(tmp_path, {last: b'{"objects": [{}]}'})

    one, two = (evaluate_file(source, ground_truth, CITYSCAPES3D, split=split) for split in (False, True))

    assert two.scores is None
    assert two.report.error_count > 0
    assert one.report == two.report


def test_what_the_second_process_does_not_look_for_is_said(
    ground_truth: GroundTruth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A refused name and a header that contradicts the directory: the same report, soon, and then the next file."""
    sound = _zip(tmp_path, {}, "sound.zip")
    nested = _zip(tmp_path, {"more.zip": b""}, "nested.zip")
    contradictory = tmp_path / "contradictory.zip"
    contradictory.write_bytes(
        sound.read_bytes().replace(b".json", b".JSON", 1)
    )  # the header comes before the directory
    sources = [nested, contradictory, sound]
    expected = [evaluate_file(source, ground_truth, CITYSCAPES3D, split=False) for source in sources]
    read, here, files_read = StrictReading._read_bytes, os.getpid(), tmp_path / "files read by the second process"

    def slowed(reading: StrictReading, number: int) -> bytes | None:
        if os.getpid() != here:
            time.sleep(0.02)
            with files_read.open("a") as file:
                file.write("x")
        return read(reading, number)

    monkeypatch.setattr(StrictReading, "_read_bytes", slowed)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        found = [both.evaluate(source) for source in sources]
        assert both.is_split
    assert len(files_read.read_text()) < 50
    assert [group.code for one in found for group in one.report.groups] == ["nested_archive", "local_header_mismatch"]
    assert [(one.scores, one.report) for one in found] == [(one.scores, one.report) for one in expected]


def test_a_file_cut_short_ends_the_second_process_only(
    ground_truth: GroundTruth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second process maps it, so that the system ends it; the first one says what is wrong with the file."""
    source = _zip(tmp_path, {})
    read, here = StrictReading._read_bytes, os.getpid()

    def cut(reading: StrictReading, number: int) -> bytes | None:
        if os.getpid() == here:
            time.sleep(0.02)  # until the other one has a turn
        else:
            faulthandler.disable()  # pytest's, which would print where it ended
            os.truncate(source, 1000)
        return read(reading, number)

    monkeypatch.setattr(StrictReading, "_read_bytes", cut)
    monkeypatch.setattr(turns, "_TURN_IMAGES", 1)
    with TwoProcesses(ground_truth, CITYSCAPES3D) as both:
        found = both.evaluate(source)
        assert not both.is_split
    assert [group.code for group in found.report.groups] == ["truncated_archive"]


@pytest.mark.parametrize("kept", [60, 3], ids=["every image", "few boxes"])
def test_recognised_mistakes_are_said(ground_truth: GroundTruth, tmp_path: Path, kept: int) -> None:
    """Quaternions written as x, y, z, w are warned of, whether both halves hold enough boxes or hardly any."""
    changes = {}
    for number, file in enumerate(sorted((CASE / "pred").iterdir())):
        boxes = json.loads(file.read_bytes())["objects"] if number < kept else []
        for box in boxes:
            box["3d"]["rotation"] = [*box["3d"]["rotation"][1:], box["3d"]["rotation"][0]]
        changes[file.name] = json.dumps({"objects": boxes}).encode()
    source = _zip(tmp_path, changes)

    one, two = (evaluate_file(source, ground_truth, CITYSCAPES3D, split=split) for split in (False, True))

    assert "quaternion_xyzw" in {group.code for group in two.report.groups}
    assert (one.scores, one.report) == (two.scores, two.report)


def test_a_mistake_that_neither_half_shows_is_said(ground_truth: GroundTruth, tmp_path: Path) -> None:
    """Of the own road there is one vehicle in two of five images, backwards: 24, of which either half has 12.

    The doctor wants twenty (FEWEST_BOXES).
    """
    changes = {}
    for number, file in enumerate(sorted((CASE / "pred").iterdir())):
        boxes = json.loads(file.read_bytes())["objects"]
        kept = [box for box in boxes if not _on_own_road(box)]
        ahead = [box for box in boxes if _on_own_road(box) and abs(_forward(box)) > 0.95]
        if number % 5 < 2:
            kept.append(ahead[0])
            if _forward(ahead[0]) > 0:
                w, x, y, z = ahead[0]["3d"]["rotation"]
                ahead[0]["3d"]["rotation"] = [-z, y, -x, w]  # half a turn about the upright axis: q k
        changes[file.name] = json.dumps({"objects": kept}).encode()
    source = _zip(tmp_path, changes)

    one, two = (evaluate_file(source, ground_truth, CITYSCAPES3D, split=split) for split in (False, True))

    assert [group.code for group in one.report.groups] == ["yaw_off_by_180"]
    assert (one.scores, one.report) == (two.scores, two.report)


def _on_own_road(box: dict[str, Any]) -> bool:
    """Tell whether a box is where the doctor looks at headings: 12 m to the right to 2 m to the left, ahead."""
    ahead, left, _ = box["3d"]["center"]
    return bool(ahead > 0 and -12 <= left <= 2)


def _forward(box: dict[str, Any]) -> float:
    """Return the cosine between the box's front and straight ahead: 1 - 2 (y y + z z) of a unit quaternion."""
    _, _, y, z = box["3d"]["rotation"]
    return float(1 - 2 * (y * y + z * z))


def test_parts_of_the_ground_truth_hold_every_box_once(ground_truth: GroundTruth) -> None:
    """Splitting anywhere loses nothing and keeps each box with its image."""
    first, rest = ground_truth_of(ground_truth, slice(0, 7)), ground_truth_of(ground_truth, slice(7, None))

    assert first.images + rest.images == ground_truth.images
    assert len(first) + len(rest) == len(ground_truth)
    assert rest.image_index.min() >= 0
    assert len(first.ignore_px) + len(rest.ignore_px) == len(ground_truth.ignore_px)
