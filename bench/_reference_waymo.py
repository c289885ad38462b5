"""Score boxes with Waymo's own metrics operation. Run by comparison_reference.py in an environment of its own.

The operation is compiled against TensorFlow 2.13 (about 1 GB on disk), so this runs by hand only.

    python _reference_waymo.py BOXES.json      prints {metric: value}
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import numpy as np  # after the setting
from waymo_open_dataset import label_pb2
from waymo_open_dataset.metrics.ops import py_metrics_ops
from waymo_open_dataset.metrics.python import config_util_py
from waymo_open_dataset.protos import breakdown_pb2, metrics_pb2

TYPES = {"car": label_pb2.Label.TYPE_VEHICLE, "bicycle": label_pb2.Label.TYPE_CYCLIST}


def configuration(camera: list[float], *, tolerant: bool) -> metrics_pb2.Config:
    """Return Waymo's published settings, for the plain or the LET metrics."""
    vehicle, other = (0.5, 0.3) if tolerant else (0.7, 0.5)
    config = metrics_pb2.Config(
        box_type=label_pb2.Label.Box.TYPE_3D,
        matcher_type=metrics_pb2.MatcherProto.TYPE_HUNGARIAN,
        iou_thresholds=[0.0, vehicle, other, other, other],
        score_cutoffs=[i * 0.01 for i in range(100)] + [1.0],
        breakdown_generator_ids=[breakdown_pb2.Breakdown.OBJECT_TYPE, breakdown_pb2.Breakdown.RANGE],
    )
    for _ in range(2):
        config.difficulties.append(metrics_pb2.Difficulty(levels=[label_pb2.Label.LEVEL_2]))
    if tolerant:
        let = config.let_metric_config
        let.enabled = True
        let.align_type = metrics_pb2.Config.LongitudinalErrorTolerantConfig.TYPE_RANGE_ALIGNED
        let.longitudinal_tolerance_percentage = 0.1
        let.min_longitudinal_tolerance_meter = 0.5
        let.sensor_location.x, let.sensor_location.y, let.sensor_location.z = camera
    return config


def columns(rows: list[dict[str, Any]]) -> tuple[np.ndarray[Any, Any], ...]:
    """Return frame, box with heading, and type of each row."""
    turns = [row["rotation"] for row in rows]
    yaw = [np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z) for w, x, y, z in turns]
    boxes = [[*row["center"], *row["dimensions"], turn] for row, turn in zip(rows, yaw, strict=True)]
    return (
        np.array([row["image"] for row in rows], dtype=np.int64),
        np.array(boxes, dtype=np.float32).reshape(-1, 7),
        np.array([TYPES[row["label"]] for row in rows], dtype=np.uint8),
    )


def waymo(boxes: dict[str, Any], *, tolerant: bool) -> dict[str, float]:
    """Return AP (and the affinity-weighted AP) of every type and range."""
    config = configuration(boxes["camera"], tolerant=tolerant)
    truth, found = columns(boxes["truth"]), columns(boxes["found"])
    metrics = py_metrics_ops.detection_metrics(
        prediction_frame_id=found[0],
        prediction_bbox=found[1],
        prediction_type=found[2],
        prediction_score=np.array([row["score"] for row in boxes["found"]], dtype=np.float32),
        prediction_overlap_nlz=np.zeros(len(found[0]), dtype=bool),
        ground_truth_frame_id=truth[0],
        ground_truth_bbox=truth[1],
        ground_truth_type=truth[2],
        ground_truth_difficulty=np.ones(len(truth[0]), dtype=np.uint8),
        config=config.SerializeToString(),
    )
    names = config_util_py.get_breakdown_names_from_config(config)
    prefix = "let_" if tolerant else ""
    scores = {}
    for index, name in enumerate(names):
        for label, kind in (("car", "TYPE_VEHICLE"), ("bicycle", "TYPE_CYCLIST")):
            if f"_{kind}_" not in name:
                continue
            part = "all" if name.startswith("OBJECT_TYPE") else name.split("[")[1].split(",")[0]
            scores[f"waymo/{label}/{part}/{prefix}ap"] = float(metrics.average_precision[index])
            if tolerant:
                weighted = metrics.average_precision_longitudinal_affinity_weighted[index]
                scores[f"waymo/{label}/{part}/let_apl"] = float(weighted)
    return scores


def main() -> None:
    """Read the boxes, print the scores."""
    boxes = json.loads(Path(sys.argv[1]).read_text())
    print(json.dumps(waymo(boxes, tolerant=False) | waymo(boxes, tolerant=True)))


main()
