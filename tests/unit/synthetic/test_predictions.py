"""Synthetic methods: complete, reproducible, as long as asked, and better when they should be."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.protocol import EVALUATED_LABELS
from evaluator.synthetic import QUALITIES, Quality, synthesize_ground_truth, synthesize_predictions, write_zip
from evaluator.synthetic.cameras import quaternions

Detected = list[dict[str, Any]]


@pytest.fixture(scope="module")
def ground_truth() -> dict[str, bytes]:
    """A hundred images."""
    return synthesize_ground_truth(100, seed=2)


def _objects(files: dict[str, bytes]) -> Detected:
    return [detected for content in files.values() for detected in json.loads(content)["objects"]]


@pytest.mark.parametrize("quality", QUALITIES, ids=lambda quality: quality.name)
def test_every_image_gets_a_file_of_valid_boxes(ground_truth: dict[str, bytes], quality: Quality) -> None:
    """One file per image; scores in [0, 1], sizes positive, labels evaluated or from the ground truth."""
    files = synthesize_predictions(ground_truth, quality, seed=1)
    assert [name.removesuffix("_predBbox3d.json") for name in files] == [
        name.removesuffix("_gtBbox3d.json") for name in ground_truth
    ]
    for detected in _objects(files):
        assert 0 <= detected["score"] <= 1
        assert min(detected["3d"]["dimensions"]) > 0
        assert detected["label"] in {*EVALUATED_LABELS, "caravan", "trailer"}
        assert np.linalg.norm(detected["3d"]["rotation"]) == pytest.approx(1, abs=1e-5)


def test_a_seed_decides_every_byte(ground_truth: dict[str, bytes]) -> None:
    """Equal arguments give equal files, another seed others."""
    first = synthesize_predictions(ground_truth, QUALITIES[0], seed=1)
    assert first == synthesize_predictions(ground_truth, QUALITIES[0], seed=1)
    assert first != synthesize_predictions(ground_truth, QUALITIES[0], seed=2)


@pytest.mark.parametrize(("mean", "lengths"), [(30, {30}), (3, {3}), (2.5, {2, 3})])
def test_lists_are_as_long_as_asked(ground_truth: dict[str, bytes], mean: float, lengths: set[int]) -> None:
    """Lists are filled up or cut: with 2.5 boxes per image they alternate between 2 and 3."""
    files = synthesize_predictions(ground_truth, QUALITIES[0], seed=1, boxes_per_image=mean)
    counts = [len(json.loads(content)["objects"]) for content in files.values()]
    assert set(counts) == lengths
    assert sum(counts) == 100 * mean


def test_scores_fall_within_each_file(ground_truth: dict[str, bytes]) -> None:
    """Detections are listed by descending score."""
    for content in synthesize_predictions(ground_truth, QUALITIES[1], seed=1, boxes_per_image=30).values():
        scores = [detected["score"] for detected in json.loads(content)["objects"]]
        assert scores == sorted(scores, reverse=True)


def test_the_best_method_finds_more_than_the_worst(ground_truth: dict[str, bytes]) -> None:
    """The best has more confident boxes, though the worst reports more boxes in all."""
    best = _objects(synthesize_predictions(ground_truth, QUALITIES[0], seed=1))
    worst = _objects(synthesize_predictions(ground_truth, QUALITIES[-1], seed=1))
    assert sum(detected["score"] > 0.8 for detected in best) > 2 * sum(detected["score"] > 0.8 for detected in worst)


def test_images_without_anything_get_empty_lists() -> None:
    """An image with no objects and no mistakes still has its file."""
    empty = json.dumps(
        {**json.loads(next(iter(synthesize_ground_truth(1, seed=1).values()))), "objects": [], "ignore": []}
    )
    files = synthesize_predictions({"bonn_000000_000019_gtBbox3d.json": empty.encode()}, QUALITIES[0], 1, 0)
    assert files == {"bonn_000000_000019_predBbox3d.json": b'{"objects":[]}'}


def test_zips_of_equal_files_are_equal(tmp_path: Path, ground_truth: dict[str, bytes]) -> None:
    """A zip depends on names and contents alone, not on the order of the mapping or the time."""
    write_zip(ground_truth, tmp_path / "a.zip")
    write_zip(dict(reversed(ground_truth.items())), tmp_path / "b.zip")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == ground_truth


def test_quaternions_follow_iso_8855() -> None:
    """A yaw of 90 degrees turns x into y: w = z = sqrt(1/2); angles of zero turn nothing."""
    half = np.pi / 2
    turned = quaternions(np.array([half, 0.0]), np.zeros(2), np.zeros(2))
    assert turned == pytest.approx(np.array([[0.5**0.5, 0, 0, 0.5**0.5], [1, 0, 0, 0]]))
