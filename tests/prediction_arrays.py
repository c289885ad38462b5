"""Predictions read the plainest way there is, so that tests of the metric do not depend on the intake."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.ground_truth import image_name
from evaluator.predictions import Predictions


def load_predictions(folder: Path, images: tuple[str, ...], labels: tuple[str, ...]) -> Predictions:
    """Read a folder of valid prediction files; an image without a file has no boxes."""
    files = {image_name(path.name): json.loads(path.read_text()) for path in sorted(folder.rglob("*.json"))}
    return assemble_predictions([files.get(image, {"objects": []})["objects"] for image in images], images, labels)


def assemble_predictions(
    objects: Iterable[list[dict[str, Any]]], images: tuple[str, ...], labels: tuple[str, ...]
) -> Predictions:
    """Turn each image's list of objects in the file format into arrays; other labels are left out."""
    labels = tuple(dict.fromkeys(labels))
    rows = [(index, item) for index, items in enumerate(objects) for item in items if item["label"] in labels]

    def numbers(values: list[Any], columns: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.array(values, dtype=np.float64).reshape(-1, columns)

    return Predictions(
        images=images,
        labels=labels,
        image_index=np.array([index for index, _ in rows], dtype=np.int32),
        label_index=np.array([labels.index(item["label"]) for _, item in rows], dtype=np.int32),
        score=np.array([item["score"] for _, item in rows], dtype=np.float64),
        center_m=numbers([item["3d"]["center"] for _, item in rows], 3),
        dimensions_m=numbers([item["3d"]["dimensions"] for _, item in rows], 3),
        rotation=numbers([item["3d"]["rotation"] for _, item in rows], 4),
        amodal_px=numbers([item["2d"]["amodal"] for _, item in rows], 4),
        modal_px=numbers([item["2d"].get("modal", item["2d"]["amodal"]) for _, item in rows], 4),
    )
