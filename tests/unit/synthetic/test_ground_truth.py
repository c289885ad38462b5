"""Synthetic ground truth against the statistics that the paper states."""

import json
import re
from collections import Counter
from typing import Any

import numpy as np
import pytest

from evaluator.synthetic import synthesize_ground_truth
from evaluator.synthetic.ground_truth import CITIES
from evaluator.synthetic.population import PROTOTYPES

Objects = list[dict[str, Any]]


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    """As many images as the test set has."""
    return synthesize_ground_truth(1525, seed=1)


@pytest.fixture(scope="module")
def objects(files: dict[str, bytes]) -> Objects:
    """Every annotated object."""
    return [annotated for content in files.values() for annotated in json.loads(content)["objects"]]


def test_a_seed_decides_every_byte() -> None:
    """Equal seeds give equal files, other seeds others."""
    assert synthesize_ground_truth(5, seed=3) == synthesize_ground_truth(5, seed=3)
    assert synthesize_ground_truth(5, seed=3) != synthesize_ground_truth(5, seed=4)


def test_no_images_give_no_files() -> None:
    """Zero images are allowed."""
    assert synthesize_ground_truth(0, seed=1) == {}


def test_files_are_named_like_the_test_set(files: dict[str, bytes]) -> None:
    """Names are sorted, unique and made of a test city, a sequence and a frame."""
    assert list(files) == sorted(files)
    assert len(files) == 1525
    assert all(re.fullmatch(r"[a-z]+_\d{6}_\d{6}_gtBbox3d\.json", name) for name in files)
    assert {name.split("_")[0] for name in files} == set(CITIES)


def test_a_file_has_the_data_sets_keys(files: dict[str, bytes], objects: Objects) -> None:
    """Keys are those of the oracle's ground truth, with the camera of the data set."""
    image = json.loads(next(iter(files.values())))
    assert list(image) == ["imgWidth", "imgHeight", "sensor", "objects", "ignore"]
    assert list(image["sensor"]) == ["fx", "fy", "u0", "v0", "baseline", "sensor_T_ISO_8855"]
    keys = ["2d", "3d", "occlusion", "truncation", "instanceId", "label", "score"]
    assert all(list(annotated) == keys for annotated in objects)
    assert list(objects[0]["3d"]) == ["center", "dimensions", "rotation", "type", "format"]


def test_classes_occur_as_often_as_in_the_paper(files: dict[str, bytes], objects: Objects) -> None:
    """Means per image are 6.4 cars, 0.2 trucks, buses and trains, 1.2 bicycles, 0.2 motorcycles."""
    counts = Counter(annotated["label"] for annotated in objects)
    # Three standard errors of a mean over 1525 images: 0.2 for 6.4 cars, 0.09 for bicycles, 0.04 for the rest.
    assert counts["car"] / len(files) == pytest.approx(6.4, abs=0.2)
    assert (counts["truck"] + counts["bus"] + counts["train"]) / len(files) == pytest.approx(0.22, abs=0.06)
    assert counts["bicycle"] / len(files) == pytest.approx(1.2, abs=0.1)
    assert counts["motorcycle"] / len(files) == pytest.approx(0.2, abs=0.05)
    assert counts["caravan"] > 0
    assert counts["trailer"] > 0
    assert 12_000 < len(objects) < 13_500


def test_nine_in_ten_objects_are_within_100_m(objects: Objects) -> None:
    """The share below 100 m is 90 %, the tail ends at 250 m."""
    distances_m = np.array([np.hypot(*annotated["3d"]["center"][:2]) for annotated in objects])
    assert (distances_m < 100).mean() == pytest.approx(0.9, abs=0.015)
    assert 200 < distances_m.max() < 250
    assert distances_m.min() < 10


def test_types_and_sizes_follow_the_table_of_prototypes(objects: Objects) -> None:
    """Every prototype occurs, and sizes lie within 15 % of it."""
    table = {prototype.name: prototype for prototype in PROTOTYPES}
    assert {annotated["3d"]["type"] for annotated in objects} == set(table)
    for annotated in objects:
        prototype = table[annotated["3d"]["type"]]
        expected = [prototype.length_m, prototype.width_m, prototype.height_m]
        assert annotated["label"] == prototype.label
        # Half a rounded centimetre on top: 0.005 / 0.42 = 1.2 % of the narrowest.
        assert annotated["3d"]["dimensions"] == pytest.approx(expected, rel=0.162)


def test_pitch_and_roll_are_small_but_present(objects: Objects) -> None:
    """Boxes are tilted by about a degree: x and y of the quaternion differ from zero, never by much."""
    rotation = np.array([annotated["3d"]["rotation"] for annotated in objects])
    tilt = np.abs(rotation[:, 1:3])
    assert 0 < np.median(tilt) < 0.02
    assert tilt.max() < 0.05
    assert np.linalg.norm(rotation, axis=1) == pytest.approx(1, abs=1e-5)


def test_occlusion_and_truncation_come_in_tenths_up_to_the_limits(objects: Objects) -> None:
    """Beyond 0.8 occluded or 0.6 truncated nothing is annotated."""
    assert {annotated["occlusion"] for annotated in objects} == {step / 10 for step in range(9)}
    assert {annotated["truncation"] for annotated in objects} == {step / 10 for step in range(7)}


def test_2d_boxes_are_visible_and_modal_lies_inside_amodal(objects: Objects) -> None:
    """Amodal boxes stay in the image and have an extent; modal boxes never leave them."""
    amodal = np.array([annotated["2d"]["amodal"] for annotated in objects])
    modal = np.array([annotated["2d"]["modal"] for annotated in objects])
    assert (amodal[:, :2] >= 0).all()
    assert (amodal[:, :2] + amodal[:, 2:] <= [2047, 1023]).all()
    assert (amodal[:, 2:] >= 7).all()
    assert (modal[:, 2:] >= 1).all()
    assert (modal[:, :2] >= amodal[:, :2]).all()
    assert ((modal[:, :2] + modal[:, 2:]) <= (amodal[:, :2] + amodal[:, 2:])).all()


def test_ignore_regions_lie_in_the_image(files: dict[str, bytes]) -> None:
    """About four in ten images have one, with the data set's keys."""
    regions = [region for content in files.values() for region in json.loads(content)["ignore"]]
    assert len(regions) / len(files) == pytest.approx(0.4, abs=0.06)
    for region in regions:
        x, y, width, height = region["2d"]
        assert region.keys() == {"2d", "label", "instanceId"}
        assert 0 <= x < x + width <= 2048
        assert 0 <= y < y + height <= 1024
