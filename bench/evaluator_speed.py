"""The evaluator beside the reference implementation, in one run, on one machine, with the results compared.

    python bench/evaluator_speed.py [--images=1525] [--boxes=30,100] [--rounds=2] [--without-reference]

The workloads are synthetic (evaluator/synthetic) and seeded: 1525 images with about 13,000 ground-truth boxes, 30 and
100 predictions for each image. Each comes twice: realistic, where most boxes are cars and most scores low, and even,
where all classes and scores are drawn evenly; the reference takes longer for the latter, for it looks at every class
with an active prediction at every threshold. Timed is the way from the zip's bytes to finished
results with the ground truth prepared; the reference reads the same files from a folder. Also measured: the floor
(inflate and typed JSON decode alone) with Python's own zip reader and with the one used here, peak memory, growth of
the cost with the boxes, attacks on the cost, and the whole command from a cold start.

A machine shared with others is at times half as fast for a minute. So everything is measured in several rounds over the
whole run, ours before and after the reference in each, and of every time the least counts, the reference's as well.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench._workload import (  # noqa: E402 - the path is set above
    GROUND_TRUTH_SEED,
    PREDICTION_SEED,
    draw_classes_evenly,
    spread_evenly,
)
from evaluator.evaluation import evaluate  # noqa: E402 - likewise
from evaluator.ground_truth import GroundTruth, read_ground_truth  # noqa: E402 - likewise
from evaluator.predictions import Predictions  # noqa: E402 - likewise
from evaluator.protocol import EVALUATED_LABELS  # noqa: E402 - likewise
from evaluator.synthetic import (  # noqa: E402 - likewise
    QUALITIES,
    synthesize_ground_truth,
    synthesize_predictions,
    write_zip,
)
from tests.reference.process import reference_python  # noqa: E402 - likewise
from tests.results_comparison import differences  # noqa: E402 - likewise

HERE = Path(__file__).parent
_TITLES = {
    "zipfile": "floor: zipfile, typed decode",
    "isal": "floor: own zip reader with isal, same",
    "one": "ours, one process",
    "two": "ours, two processes",
}


def main() -> int:
    """Run all measurements; status 1 when results differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--boxes", type=lambda text: [int(part) for part in text.split(",")], default=[30, 100])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--without-reference", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = synthesize_ground_truth(args.images, GROUND_TRUTH_SEED)
        workloads = {"realistic": files, "even": draw_classes_evenly(files)}
        ground_truths = {kind: _prepare(folder / kind, workloads[kind]) for kind in workloads}
        print(f"{args.images} images, {len(ground_truths['even'])} ground-truth boxes, {os.cpu_count()} processors")
        python = None if args.without_reference else reference_python()
        measurements = [
            _Measurement.of(folder / kind, of_kind, boxes, is_even=kind == "even")
            for boxes in args.boxes
            for kind, of_kind in workloads.items()
        ]
        for number in range(args.rounds):
            for measurement in measurements:
                print(f"round {number + 1} of {args.rounds}: {measurement.path.stem}", file=sys.stderr, flush=True)
                measurement.run(python)
        for measurement in measurements:
            measurement.show()
        _command(measurements[0])
        _growth(files)
        _attacks(ground_truths["realistic"])
    return 1 if any(measurement.differences for measurement in measurements) else 0


def _prepare(folder: Path, files: dict[str, bytes]) -> GroundTruth:
    """Write ground truth as a zip and as the array file that is read at once."""
    folder.mkdir()
    write_zip(files, folder / "gt.zip")
    ground_truth = read_ground_truth(folder / "gt.zip")
    (folder / "gt.arrays").write_bytes(ground_truth.to_bytes())
    return ground_truth


@dataclass(kw_only=True)
class _Measurement:
    """One workload, and what was measured of it so far."""

    folder: Path
    path: Path
    json_bytes: int
    least: dict[str, dict[str, float]] = field(default_factory=dict)
    reference: dict[str, float] = field(default_factory=dict)
    """Seconds and processor seconds; empty without the reference."""
    differences: list[str] = field(default_factory=list)
    """Where the results are not the reference's."""

    @classmethod
    def of(cls, folder: Path, files: dict[str, bytes], boxes: int, *, is_even: bool) -> "_Measurement":
        """Write the predictions, so many for each image."""
        predictions = synthesize_predictions(files, QUALITIES[0], PREDICTION_SEED, boxes)
        if is_even:
            predictions = spread_evenly(predictions)
        path = folder / f"{boxes} predictions per image, {folder.name}.zip"
        write_zip(predictions, path)
        return cls(folder=folder, path=path, json_bytes=sum(map(len, predictions.values())))

    def run(self, python: Path | None) -> None:
        """Measure ours before and after the reference, and compare the results."""
        self._measure_ours()
        if python is not None:
            seconds, expected = _reference(self.folder, self.path, python)
            self.reference = _least(self.reference, seconds)
            ours = json.loads((self.folder / "one.json").read_text())
            self.differences += map(str, differences(ours, expected))
        self._measure_ours()

    def _measure_ours(self) -> None:
        for what in _TITLES:
            self.least[what] = _least(self.least.get(what, {}), _measure(what, self.folder, self.path))

    def show(self) -> None:
        """Print the least of everything."""
        size = f"{self.json_bytes / 1e6:.0f} MB of JSON, {self.path.stat().st_size / 1e6:.0f} MB zip"
        print(f"\n{self.path.stem}: {size}")
        print(
            f"  {'':36} seconds  median  processor  x zipfile  x isal  peak MB  x reference, by seconds (by processor)"
        )
        if self.reference:
            print(f"  {'reference':36} {self.reference['s']:7.2f}          {self.reference['processor_s']:9.2f}")
        for what, line in _TITLES.items():
            values = self.least[what]
            best_s, processor_s = values["best_s"], values["processor_s"]
            floors = [processor_s / self.least[floor]["processor_s"] for floor in ("zipfile", "isal")]
            faster = ""
            if self.reference:
                faster = f"{self.reference['s'] / best_s:6.0f} ({self.reference['processor_s'] / processor_s:.0f})"
            print(
                f"  {line:36} {best_s:7.3f} {values['median_s']:7.3f}  {processor_s:9.3f}"
                f"  {floors[0]:9.2f}  {floors[1]:6.2f}  {values['peak_mb']:7.0f}  {faster}"
            )
        if self.reference:
            count = len(self.differences)
            found = f"{count} differences, first {self.differences[0]}" if count else "every number equal to 1e-9"
            print(f"  results: {found}", flush=True)


def _measure(what: str, folder: Path, path: Path) -> dict[str, float]:
    """Run one measurement in a fresh process, on one processor unless it uses two."""
    command: list[str | Path] = [
        sys.executable,
        HERE / "_measure.py",
        what,
        folder / "gt.arrays",
        path,
        folder / f"{what}.json",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pinned = None if what == "two" or not hasattr(os, "sched_setaffinity") else _pin
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, preexec_fn=pinned)
    return dict(json.loads(done.stdout))


def _least(before: dict[str, float], values: dict[str, float]) -> dict[str, float]:
    """Return the least of what was measured before and what follows, but the greatest peak."""
    return {name: (max if name == "peak_mb" else min)(value, before.get(name, value)) for name, value in values.items()}


def _pin() -> None:
    """Stay on one processor."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _reference(folder: Path, path: Path, python: Path) -> tuple[dict[str, float], Any]:
    """Return the reference's seconds and processor seconds, and its results."""
    work = folder / path.stem
    for name, source in (("gt", folder / "gt.zip"), ("pred", path)):
        with zipfile.ZipFile(source) as archive:
            archive.extractall(work / name)
    result = folder / "reference.json"
    timed = [HERE / "_time_reference.py", work / "gt", work / "pred", result]
    done = subprocess.run([python, "-W", "ignore", *timed], cwd=folder, capture_output=True, check=True)
    seconds, processor_s = map(float, done.stdout.split()[-2:])
    return {"s": seconds, "processor_s": processor_s}, json.loads(result.read_text())


def _command(measurement: _Measurement) -> None:
    """Time the whole command from a cold start: imports, reading the ground truth's zip, everything."""
    command: list[str | Path] = [
        sys.executable,
        "-m",
        "client.main",
        "evaluate",
        "--gt",
        measurement.folder / "gt.zip",
        measurement.path,
    ]
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        subprocess.run(
            command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True, preexec_fn=_pin
        )
        seconds.append(time.perf_counter() - start)
    print(f"\ncs3d evaluate, cold, one processor, {measurement.path.stem}: {min(seconds):.2f} s")


def _growth(files: dict[str, bytes]) -> None:
    """Show that the cost grows linearly to 1000 boxes an image (arrays to scores, 150 images)."""
    print("\ngrowth with the boxes per image, 150 images, arrays to scores, processor seconds")
    some = dict(list(files.items())[:150])
    with tempfile.TemporaryDirectory() as name:
        write_zip(some, Path(name) / "gt.zip")
        ground_truth = read_ground_truth(Path(name) / "gt.zip")
    rng = np.random.default_rng(3)
    for boxes in (30, 100, 300, 1000):
        predictions = _copies(ground_truth, rng.integers(0, len(ground_truth), 150 * boxes), rng.random(150 * boxes))
        predictions = replace(predictions, center_m=predictions.center_m + rng.normal(0, 0.05, (len(predictions), 3)))
        seconds = _best(ground_truth, predictions)
        print(f"  {boxes:5} per image  {seconds:7.3f} s  {1e6 * seconds / (150 * boxes):6.2f} us a box")


def _attacks(ground_truth: GroundTruth) -> None:
    """Show that the known attacks on the cost are linear (arrays to scores)."""
    print("\nattacks in one image, all scores 1, arrays to scores, processor seconds")
    image = int(ground_truth.ignore_image_index[0])
    region = ground_truth.ignore_px[0]
    row = int(np.searchsorted(ground_truth.image_index, image))
    for count in (1000, 4000, 100_000):
        equal = _copies(ground_truth, np.full(count, row), np.ones(count))
        spread = replace(equal, modal_px=np.tile(region, (count, 1)), center_m=equal.center_m + np.array([300.0, 0, 0]))
        scored = replace(equal, score=np.linspace(0, 1, count))
        print(
            f"  {count:6} boxes: in an ignore region {_best(ground_truth, spread):.4f} s, duplicates of one ground-truth "
            f"box {_best(ground_truth, equal):.4f} s, with rising scores {_best(ground_truth, scored):.4f} s"
        )


def _copies(ground_truth: GroundTruth, rows: np.ndarray[Any, Any], score: np.ndarray[Any, Any]) -> Predictions:
    """Predict ground-truth boxes, a little beside where they are."""
    order = np.argsort(ground_truth.image_index[rows], kind="stable")
    rows = rows[order]
    labels = [EVALUATED_LABELS.index(label) if label in EVALUATED_LABELS else 0 for label in ground_truth.labels]
    return Predictions(
        images=ground_truth.images,
        labels=EVALUATED_LABELS,
        image_index=ground_truth.image_index[rows],
        label_index=np.array(labels, dtype=np.int32)[ground_truth.label_index[rows]],
        score=score[order],
        center_m=ground_truth.center_m[rows] * 1.0005,
        dimensions_m=ground_truth.dimensions_m[rows],
        rotation=ground_truth.rotation[rows],
        amodal_px=ground_truth.amodal_px[rows],
        modal_px=ground_truth.modal_px[rows],
    )


def _best(ground_truth: GroundTruth, predictions: Predictions) -> float:
    """Return the least processor seconds of three evaluations."""
    seconds = []
    for _ in range(3):
        start = time.process_time()
        evaluate(ground_truth, predictions)
        seconds.append(time.process_time() - start)
    return min(seconds)


if __name__ == "__main__":
    sys.exit(main())
