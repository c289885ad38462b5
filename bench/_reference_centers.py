"""Score boxes with nuscenes-devkit and av2 themselves. Run by comparison_reference.py in an environment of its own.

Both packages pull in maps, plots and learning frameworks that their metrics never call; those imports are answered by
empty stand-ins, so that two small wheels without dependencies are enough.

    python _reference_centers.py BOXES.json      prints {metric: value}
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

NEVER_CALLED = (
    "PIL",
    "av2.map",
    "av2.map.map_api",
    "av2.structures",
    "av2.structures.cuboid",
    "av2.utils.io",
    "cachetools",
    "cv2",
    "descartes",
    "fire",
    "joblib",
    "matplotlib",
    "matplotlib.axes",
    "matplotlib.pyplot",
    "nuscenes.nuscenes",
    "nuscenes.utils.data_classes",
    "polars",
    "shapely",
    "shapely.geometry",
    "sklearn",
    "sklearn.metrics",
    "tqdm",
    "upath",
)
sys.modules.update({name: MagicMock() for name in NEVER_CALLED})
sys.modules["av2.structures.cuboid"].__dict__["ORDERED_CUBOID_COL_NAMES"] = []

import numpy as np  # noqa: E402  # after the stand-ins
import pandas as pd  # noqa: E402
from av2.evaluation.detection.eval import summarize_metrics  # noqa: E402
from av2.evaluation.detection.utils import DetectionCfg, accumulate  # noqa: E402
from nuscenes.eval.common.data_classes import EvalBoxes  # noqa: E402
from nuscenes.eval.common.utils import center_distance  # noqa: E402
from nuscenes.eval.detection import algo  # noqa: E402
from nuscenes.eval.detection.data_classes import DetectionBox  # noqa: E402

Row = dict[str, Any]


def nuscenes_boxes(rows: list[Row]) -> EvalBoxes:
    """Turn rows into the devkit's boxes, one sample for each image."""
    samples = defaultdict(list)
    for row in rows:
        length, width, height = row["dimensions"]
        box = DetectionBox(
            sample_token=str(row["image"]),
            translation=tuple(row["center"]),
            size=(width, length, height),
            rotation=tuple(row["rotation"]),
            detection_name=row["label"],
            detection_score=float(row.get("score", -1.0)),
        )
        samples[str(row["image"])].append(box)
    boxes = EvalBoxes()
    for token, listed in samples.items():
        boxes.add_boxes(token, listed)
    return boxes


def nuscenes(truth: list[Row], found: list[Row], label: str) -> dict[str, float]:
    """Return AP by distance and the three errors of one class."""
    sides = nuscenes_boxes(truth), nuscenes_boxes(found)
    scores = {}
    for distance_m in (0.5, 1.0, 2.0, 4.0):
        data = algo.accumulate(*sides, label, center_distance, distance_m)
        scores[f"nuscenes/{label}/ap@{distance_m}"] = algo.calc_ap(data, 0.1, 0.1)
        if distance_m == 2.0:  # noqa: PLR2004  # the distance of the true-positive errors
            for name in ("trans_err", "scale_err", "orient_err"):
                scores[f"nuscenes/{label}/{name}"] = algo.calc_tp(data, 0.1, name)
    return scores


def argoverse_rows(rows: list[Row], last: str) -> np.ndarray[Any, Any]:
    """Turn rows of one image and class into av2's table."""
    return np.array(
        [[*row["center"], *row["dimensions"], *row["rotation"], row.get(last, 1)] for row in rows], dtype=float
    ).reshape(-1, 11)


def argoverse(truth: list[Row], found: list[Row], label: str) -> dict[str, float]:
    """Return AP, the three errors and CDS of one class."""
    config = DetectionCfg(categories=(label,), eval_only_roi_instances=False)
    names = [*config.affinity_thresholds_m, "ATE", "ASE", "AOE", "is_evaluated"]
    tables: tuple[list[pd.DataFrame], list[pd.DataFrame]] = [], []
    for image in sorted({row["image"] for row in truth + found}):
        detections = argoverse_rows([row for row in found if row["image"] == image], "score")
        annotations = argoverse_rows([row for row in truth if row["image"] == image], "points")
        scored = accumulate(detections, annotations, config)
        tables[0].append(pd.DataFrame(scored[0], columns=names).assign(score=detections[:, -1], category=label))
        tables[1].append(pd.DataFrame(scored[1], columns=names).assign(category=label))
    summary = summarize_metrics(pd.concat(tables[0]), pd.concat(tables[1]), config).loc[label]
    return {f"argoverse/{label}/{name.lower()}": float(summary[name]) for name in ("AP", "ATE", "ASE", "AOE", "CDS")}


def main() -> None:
    """Read the boxes, print the scores."""
    boxes = json.loads(Path(sys.argv[1]).read_text())
    scores: dict[str, float] = {}
    for label in boxes["labels"]:
        truth, found = ([row for row in boxes[side] if row["label"] == label] for side in ("truth", "found"))
        scores |= nuscenes(truth, found, label) | argoverse(truth, found, label)
    print(json.dumps(scores))


main()
