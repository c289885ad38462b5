"""Random evaluation cases that look for trouble: near-plane boxes, ties, scores on thresholds, every parameter.

Files are in the real format, drawn from a seed. What the reference cannot evaluate (a pitch of exactly 90 degrees,
zero sizes) is not drawn; everything else that may occur in valid files is.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.projection import projected_corners_px

LABELS = ("car", "truck", "bus", "train", "motorcycle", "bicycle", "caravan", "trailer")
CAMERA = [
    [0.9990881051503779, -0.01948468779721943, -0.03799085532693703, -1.6501524664770573],
    [0.019498764210995674, 0.9998098810245096, 0.0, -0.1331288872611436],
    [0.03798363254444427, -0.0007407747301939942, 0.9992780868764849, -1.2836173638418473],
]
PLAIN_CAMERA = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]

SCORE_STEPS = (50, 50, 50, 20, 10, 7, 25, 60)
"""All of them reach 1: where `numpy.arange` ends below it, the reference fails on a working point of 1."""


def write_case(seed: int, folder: Path) -> dict[str, Any]:
    """Write one case below a folder and return it as `reference_results` takes it."""
    rng = np.random.default_rng(seed)
    labels = list(rng.choice(LABELS, size=rng.integers(1, 5), replace=False))
    gt_folder, pred_folder = folder / f"{seed}" / "gt", folder / f"{seed}" / "pred"
    for index in range(int(rng.integers(1, 7))):
        name = f"city{index % 3}_{index:06d}_000019"
        gt, predictions = _image(rng, labels)
        _write(gt_folder / f"{name}_gtBbox3d.json", gt)
        if predictions is not None:
            _write(pred_folder / f"{name}_predBbox3d.json", {"objects": predictions})
    pred_folder.mkdir(parents=True, exist_ok=True)
    return {"gt": str(gt_folder), "pred": str(pred_folder), "parameters": _parameters(rng, labels)}


def _floats(values: Any) -> list[float]:
    """Return numpy numbers as JSON takes them."""
    return [float(value) for value in values]


def _write(path: Path, document: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document), encoding="utf-8")


def _parameters(rng: np.random.Generator, labels: list[str]) -> dict[str, Any]:
    evaluated = [str(label) for label in rng.permutation([*labels, "person"][: rng.integers(1, len(labels) + 2)])]
    return {
        "labels": evaluated if rng.random() < 0.5 else list(LABELS[:6]),
        "min_iou": float(rng.choice([0.7, 0.7, 0.7, 0.5, 0.3, 0.0, 0.9, 1.0])),
        "max_depth": int(rng.choice([100, 100, 97, 50, 33, 7, 200])),
        "step_size": int(rng.choice([5, 5, 10, 7, 3, 1, 250])),
        "modal": bool(rng.random() < 0.3),
        "cw": float(rng.choice([-1, -1, -1, 0, 1, 0.7, 0.82, 0.5, 0.333, 1.3, -0.5])),
        "num_conf": int(rng.choice(SCORE_STEPS)),
    }


def _image(rng: np.random.Generator, labels: list[str]) -> tuple[dict[str, Any], list[dict[str, Any]] | None]:
    sensor = _sensor(rng)
    truth = [_true_object(rng, labels, sensor) for _ in range(int(rng.integers(0, 9)))]
    truth += [json.loads(json.dumps(item)) for item in truth if rng.random() < 0.08]
    predictions = [_prediction(rng, item, labels) for item in truth for _ in range(int(rng.integers(0, 4)))]
    predictions += [_prediction(rng, _true_object(rng, labels, sensor), labels) for _ in range(int(rng.integers(0, 5)))]
    predictions += [json.loads(json.dumps(item)) for item in predictions if rng.random() < 0.15]
    predictions += [_described_otherwise(rng, item) for item in predictions if rng.random() < 0.15]
    rng.shuffle(predictions)
    regions = [{"2d": _region(rng, predictions), "label": "vehicle"} for _ in range(int(rng.integers(0, 4)))]
    gt = {"imgWidth": 2048, "imgHeight": 1024, "sensor": sensor, "objects": truth, "ignore": regions}
    return gt, None if rng.random() < 0.05 else predictions


def _sensor(rng: np.random.Generator) -> dict[str, Any]:
    if rng.random() < 0.2:
        return {"fx": 1000, "fy": 1000, "u0": 1024, "v0": 512, "sensor_T_ISO_8855": PLAIN_CAMERA}
    return {"fx": 2262.52, "fy": 2265.3017905988554, "u0": 1096.98, "v0": 513.137, "sensor_T_ISO_8855": CAMERA}


def _true_object(rng: np.random.Generator, labels: list[str], sensor: dict[str, Any]) -> dict[str, Any]:
    item = {
        "3d": {"center": _center(rng), "dimensions": _dimensions(rng), "rotation": _rotation(rng), "type": "Sedan"},
        "label": str(rng.choice(labels)),
        "score": 1.0,
    }
    amodal = _projected(item, sensor)
    style = rng.random()
    if style < 0.4:
        amodal = [round(value) for value in amodal]
    elif style < 0.6:
        amodal = (np.array(amodal) + rng.normal(0, 2, 4)).tolist()
    amodal[2:] = [max(value, 0) for value in amodal[2:]]
    return {**item, "2d": _with_modal(rng, amodal)}


def _center(rng: np.random.Generator) -> list[float]:
    style = rng.random()
    if style < 0.1:  # around the camera: cut by the near plane, or behind it
        return _floats(rng.uniform([-6, -4, 0], [6, 4, 2]))
    if style < 0.15:
        return _floats(rng.uniform([-60, -30, 0], [-5, 30, 2]))
    if style < 0.35:  # exactly on the edge of a depth bin: 3-4-5 triangles
        k = int(rng.integers(1, 25))
        return [4 * k, int(rng.choice([-3, 3])) * k, 1]
    if style < 0.45:
        return _floats(rng.uniform([80, -20, 0], [260, 20, 2]).round(3))
    return _floats(rng.uniform([5, -10, 0], [60, 10, 2]).round(int(rng.integers(0, 6))))


def _dimensions(rng: np.random.Generator) -> list[float]:
    if rng.random() < 0.1:
        return [4, 2, 1]
    return _floats(rng.uniform([0.5, 0.3, 0.5], [12, 3, 4]).round(2))


def _rotation(rng: np.random.Generator) -> list[float]:
    style = rng.random()
    if style < 0.2:
        return [1, 0, 0, 0]
    if style < 0.6:
        yaw = rng.uniform(-np.pi, np.pi)
        tilt = rng.normal(0, 0.02, 2)
        return [float(np.cos(yaw / 2)), *tilt.round(6).tolist(), float(np.sin(yaw / 2))]
    if style < 0.8:
        return _floats(rng.normal(0, 1, 4) * rng.choice([0.01, 1, 50]))
    return _floats(rng.normal(0, 1, 4).round(2))


def _projected(item: dict[str, Any], sensor: dict[str, Any]) -> list[float]:
    box = item["3d"]
    x_min, y_min, x_max, y_max = projected_corners_px(
        np.array([box["center"]], dtype=float),
        np.array([box["dimensions"]], dtype=float),
        np.array([box["rotation"]], dtype=float),
        intrinsics_px=np.array([[sensor[key] for key in ("fx", "fy", "u0", "v0")]], dtype=float),
        sensor_from_vehicle=np.array([sensor["sensor_T_ISO_8855"]], dtype=float),
        camera_index=np.zeros(1, dtype=np.int32),
    )[:, 0].tolist()
    return [x_min, y_min, x_max - x_min, y_max - y_min]


def _with_modal(rng: np.random.Generator, amodal: list[float]) -> dict[str, Any]:
    style = rng.random()
    if style < 0.3:
        return {"amodal": amodal}
    if style < 0.6:
        return {"amodal": amodal, "modal": list(amodal)}
    x, y, width, height = amodal
    return {"amodal": amodal, "modal": [x, y, width * float(rng.choice([0.5, 0.8, 0.95])), height]}


def _prediction(rng: np.random.Generator, item: dict[str, Any], labels: list[str]) -> dict[str, Any]:
    box = item["3d"]
    spread = float(rng.choice([0, 0, 1e-12, 1e-3, 0.02, 0.2]))
    shift = rng.normal(0, 1, 3) * spread * (1, 1, 0.2)
    center = [a + b for a, b in zip(box["center"], shift.tolist(), strict=True)] if spread else box["center"]
    sizes = [a * float(np.exp(b)) for a, b in zip(box["dimensions"], rng.normal(0, spread, 3), strict=True)]
    turn = rng.normal(0, spread * 0.3, 4) * float(np.linalg.norm(box["rotation"]))
    rotation = [a + b for a, b in zip(box["rotation"], turn.tolist(), strict=True)] if spread else box["rotation"]
    amodal = item["2d"]["amodal"]
    if rng.random() < 0.3:
        amodal = [max(value, 0) for value in (np.array(amodal) + rng.normal(0, 3, 4)).round(1).tolist()]
    return {
        "2d": _with_modal(rng, amodal),
        "3d": {"center": center, "dimensions": sizes if spread else box["dimensions"], "rotation": rotation},
        "label": item["label"] if rng.random() < 0.9 else str(rng.choice(labels)),
        "score": _score(rng),
    }


def _described_otherwise(rng: np.random.Generator, item: dict[str, Any]) -> dict[str, Any]:
    """Describe the same shape with other numbers: turned by 180 degrees, or with a quaternion of another length."""
    w, x, y, z = item["3d"]["rotation"]
    rotation = [-z, y, -x, w] if rng.random() < 0.5 else [3 * w, 3 * x, 3 * y, 3 * z]
    return {**item, "3d": {**item["3d"], "rotation": rotation}, "score": _score(rng)}


def _score(rng: np.random.Generator) -> float:
    style = rng.random()
    if style < 0.3:
        return int(rng.integers(0, 51)) / 50
    if style < 0.4:
        return float(np.arange(0, 1.01, 0.02)[rng.integers(0, 51)])
    if style < 0.5:
        return int(rng.integers(0, 2))
    return float(rng.random())


def _region(rng: np.random.Generator, predictions: list[dict[str, Any]]) -> list[float]:
    if predictions and rng.random() < 0.6:
        box = predictions[int(rng.integers(len(predictions)))]["2d"]
        x, y, width, height = box.get("modal", box["amodal"])
        return [x, y, width * float(rng.choice([0.7, 0.69, 0.71, 1, 2])), height]
    return [int(value) for value in rng.uniform([0, 200, 10, 10], [1800, 700, 600, 300])]
