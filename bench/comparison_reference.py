"""Compare our comparison metrics with the packages they follow, number by number, on the same random boxes.

    python bench/comparison_reference.py [--seeds 20] [--waymo] [--record tests/data/comparison]

nuscenes-devkit 1.2.0 and av2 0.3.6 are installed without their dependencies in `.cache/comparison_references/centers`
(about 400 MB, most of it pandas and scipy), Waymo's metrics with TensorFlow 2.13 in `.cache/comparison_references/waymo`
(1.2 GB, only with --waymo). For KITTI, which has no package, tests/kitti_by_definition.py stands in. Exits with 1 if any number differs by more than its tolerance.
--record keeps boxes and reference numbers for the tests, which then need none of the packages.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import venv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from evaluator.comparison.summary import ComparisonMetrics, comparison_metrics  # noqa: E402  # after the path
from tests.array_factories import (  # noqa: E402
    Box,
    disturbed_boxes,
    make_ground_truth,
    make_predictions,
    scattered_boxes,
)
from tests.kitti_by_definition import kitti_scores  # noqa: E402  # after the path

IMAGES = 12
LABELS = ("car", "bicycle")
CAMERA = (1.7, 0.1, 1.2)
SPREADS = (0.3, 0.6, 1.0, 0.0)
"""From nearly perfect to poor, and perfect boxes with duplicates."""
TILTED = 4
"""Of every five scenes this one has tilted boxes, whose tilt all four benchmarks drop."""
Quaternion = tuple[float, float, float, float]
WITHOUT_DEPENDENCIES = {
    "centers": ("nuscenes-devkit==1.2.0", "av2==0.3.6"),
    "waymo": ("waymo-open-dataset-tf-2-12-0==1.6.7",),
}
WITH_DEPENDENCIES = {
    "centers": ("numpy==2.4.6", "pandas==3.1.1", "pyquaternion==0.9.9", "scipy==1.17.1"),
    "waymo": ("tensorflow-cpu==2.13.0", "numpy==1.24.3"),
}
TOLERANCE = {"kitti": 1e-9, "nuscenes": 1e-9, "argoverse": 1e-9, "waymo": 2e-6}
"""Waymo computes in single precision."""


def interpreter(name: str) -> Path:
    """Return the Python of a reference's environment, building it first if it is not there."""
    folder = ROOT / ".cache" / "comparison_references" / name
    python = folder / "bin" / "python"
    if not (folder / "ready").exists():
        print(f"building {folder.relative_to(ROOT)} ...", flush=True)
        venv.create(folder, with_pip=True, clear=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, *WITH_DEPENDENCIES[name]], check=True)
        subprocess.run([*pip, "--no-deps", *WITHOUT_DEPENDENCIES[name]], check=True)
        (folder / "ready").touch()
    return python


def rows(boxes: list[Box]) -> list[dict[str, Any]]:
    """Return boxes as JSON rows."""
    return [
        {
            "image": box.image,
            "label": box.label,
            "center": box.center,
            "dimensions": box.dimensions,
            "rotation": box.quaternion(),
            "score": box.score,
        }
        for box in boxes
    ]


def reference_scores(name: str, truth: list[Box], found: list[Box]) -> dict[str, float]:
    """Run a reference on the boxes in its own process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "boxes.json"
        path.write_text(json.dumps({"labels": LABELS, "camera": CAMERA, "truth": rows(truth), "found": rows(found)}))
        script = Path(__file__).with_name(f"_reference_{name}.py")
        done = subprocess.run([interpreter(name), script, path], check=True, capture_output=True, text=True)
    scores: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return scores


def our_scores(comparison: ComparisonMetrics) -> dict[str, float | None]:
    """Name our numbers as the references name theirs; undefined errors take the value the references give them."""
    scores: dict[str, float | None] = {}
    for overlapped in comparison.kitti.classes:
        for part in overlapped.overlaps:
            scores[f"kitti/{overlapped.label}/ap_bev@{part.min_iou}"] = part.ap_bev
            scores[f"kitti/{overlapped.label}/ap_3d@{part.min_iou}"] = part.ap_3d
    for seen in comparison.nuscenes.classes:
        scores |= {
            f"nuscenes/{seen.label}/ap@{distance}": ap
            for distance, ap in zip(comparison.nuscenes.parameters.distances_m, seen.ap_by_distance, strict=True)
        }
        for name, error in (("trans_err", seen.ate_m), ("scale_err", seen.ase), ("orient_err", seen.aoe_rad)):
            scores[f"nuscenes/{seen.label}/{name}"] = 1.0 if error is None else error
    for composite in comparison.argoverse.classes:
        for name, value in (
            ("ap", composite.ap),
            ("ate", composite.ate_m),
            ("ase", composite.ase),
            ("aoe", composite.aoe_rad),
            ("cds", composite.cds),
        ):
            scores[f"argoverse/{composite.label}/{name}"] = value
    for ranged in comparison.waymo.classes:
        parts = [("all", ranged.overall), *((f"{part.lower_m:.0f}", part) for part in ranged.ranges)]
        for name, within in parts:
            scores[f"waymo/{ranged.label}/{name}/ap"] = within.ap or 0.0
            scores[f"waymo/{ranged.label}/{name}/let_ap"] = within.let_ap or 0.0
            scores[f"waymo/{ranged.label}/{name}/let_apl"] = within.let_apl or 0.0
    return scores


def scene(seed: int) -> tuple[list[Box], list[Box]]:
    """Return ground truth and predictions of one seed."""
    spacing_m = (1.5, 1.2) if seed % 5 == 0 else (9.0, 8.0)  # every fifth scene is so crowded that boxes overlap
    truth = scattered_boxes(seed, images=IMAGES, per_image=12, labels=LABELS, spacing_m=spacing_m)
    found = disturbed_boxes(seed + 1000, truth, images=IMAGES, spread=SPREADS[seed % len(SPREADS)])
    return (tilted(truth, seed), tilted(found, seed + 1)) if seed % 5 == TILTED else (truth, found)


def tilted(boxes: list[Box], seed: int) -> list[Box]:
    """Return the boxes on slopes of some degrees: pitched and rolled, with the headings they had."""
    half = np.random.default_rng(seed).normal(0, 0.08, (len(boxes), 2)) / 2
    tilts = zip(boxes, np.cos(half).tolist(), np.sin(half).tolist(), strict=True)
    return [replace(box, rotation=_product(box.quaternion(), *tilt)) for box, *tilt in tilts]


def _product(heading: Quaternion, cosines: list[float], sines: list[float]) -> Quaternion:
    """Return a turn about the vertical axis, after a pitch, after a roll."""
    (w, _, _, z), (cy, cx), (sy, sx) = heading, cosines, sines
    return (
        w * cy * cx + z * sy * sx,
        w * cy * sx - z * sy * cx,
        w * sy * cx + z * cy * sx,
        z * cy * cx - w * sy * sx,
    )


def worst_differences(truth: list[Box], found: list[Box], expected: dict[str, float]) -> dict[str, tuple[float, str]]:
    """Return the greatest difference of each benchmark, with the number it occurs in."""
    ground_truth = make_ground_truth(truth, images=IMAGES, camera=CAMERA)
    ours = our_scores(comparison_metrics(ground_truth, make_predictions(found, images=IMAGES)))
    worst: dict[str, tuple[float, str]] = {}
    for key, reference in expected.items():
        value = ours[key]
        difference = float("inf") if value is None else abs(value - reference)
        benchmark = key.split("/")[0]
        worst[benchmark] = max(worst.get(benchmark, (0.0, "")), (difference, key))
    return worst


def main() -> int:
    """Compare all seeds, print a line for each, and say whether all agree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--waymo", action="store_true", help="compare with Waymo's operation too (1.2 GB)")
    parser.add_argument("--record", type=Path, help="write boxes and reference numbers of each seed to this folder")
    arguments = parser.parse_args()
    agree = True
    for seed in range(arguments.seeds):
        truth, found = scene(seed)
        expected = reference_scores("centers", truth, found) | kitti_scores(truth, found, LABELS)
        if arguments.waymo:
            expected |= reference_scores("waymo", truth, found)
        if arguments.record:
            record(arguments.record / f"seed_{seed}.json", truth, found, expected)
        worst = worst_differences(truth, found, expected)
        agree &= all(difference <= TOLERANCE[benchmark] for benchmark, (difference, _) in worst.items())
        print(seed, *(f"{name} {difference:.1e} ({key})" for name, (difference, key) in worst.items()), sep="  ")
    print("all agree" if agree else "NOT equal")
    return 0 if agree else 1


def record(path: Path, truth: list[Box], found: list[Box], expected: dict[str, float]) -> None:
    """Keep one scene and what the references say about it."""
    content = {"images": IMAGES, "camera": CAMERA, "truth": rows(truth), "found": rows(found), "expected": expected}
    path.write_text(json.dumps(content, indent=None, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    sys.exit(main())
