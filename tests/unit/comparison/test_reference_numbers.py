"""Equality with nuscenes-devkit, av2, Waymo's metrics operation and KITTI's definition on recorded scenes.

`bench/comparison_reference.py --waymo --record tests/data/comparison` made the files: random boxes, and the numbers the
packages themselves give for them; those of KITTI are from tests/kitti_by_definition.py. Scene 0 is so crowded that boxes overlap; scene 3 is perfect but for duplicates; in scene 4, which has no
numbers of Waymo's operation, boxes are tilted.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from evaluator.comparison.argoverse import ArgoverseClass
from evaluator.comparison.nuscenes import NuscenesClass
from evaluator.comparison.summary import ComparisonMetrics, comparison_metrics
from evaluator.comparison.waymo import WaymoClass, WaymoRange
from tests.array_factories import Box, make_ground_truth, make_predictions

SCENES = sorted((Path(__file__).parents[2] / "data" / "comparison").glob("seed_*.json"))


def boxes(rows: list[dict[str, Any]]) -> list[Box]:
    """Turn recorded rows into boxes."""
    return [Box(**{**row, "center": tuple(row["center"]), "dimensions": tuple(row["dimensions"])}) for row in rows]


@pytest.fixture(scope="module", params=SCENES, ids=lambda path: path.stem)
def scored(request: pytest.FixtureRequest) -> tuple[ComparisonMetrics, dict[str, float]]:
    """Return our numbers and the recorded ones of a scene."""
    content = json.loads(request.param.read_text())
    ground_truth = make_ground_truth(boxes(content["truth"]), images=content["images"], camera=content["camera"])
    predictions = make_predictions(boxes(content["found"]), images=content["images"])
    return comparison_metrics(ground_truth, predictions), content["expected"]


def expected_of(expected: dict[str, float], prefix: str) -> dict[str, float]:
    """Return the recorded numbers below a prefix, without it."""
    return {key.removeprefix(prefix): value for key, value in expected.items() if key.startswith(prefix)}


def test_scenes_are_recorded() -> None:
    """The recorded scenes are there, the first four with Waymo's numbers."""
    assert len(SCENES) == 5
    assert ["waymo/car/all/ap" in json.loads(path.read_text())["expected"] for path in SCENES] == [True] * 4 + [False]


def nuscenes_numbers(score: NuscenesClass, distances_m: tuple[float, ...]) -> dict[str, float | None]:
    """Name our nuScenes numbers as the devkit does."""
    named = {f"ap@{distance}": ap for distance, ap in zip(distances_m, score.ap_by_distance, strict=True)}
    return named | {"trans_err": score.ate_m, "scale_err": score.ase, "orient_err": score.aoe_rad}


def test_nuscenes_numbers_equal_the_devkit(scored: tuple[ComparisonMetrics, dict[str, float]]) -> None:
    """AP at each distance and the three errors equal nuscenes-devkit."""
    comparison, expected = scored
    for label in ("car", "bicycle"):
        score = next(score for score in comparison.nuscenes.classes if score.label == label)
        numbers = nuscenes_numbers(score, comparison.nuscenes.parameters.distances_m)
        assert numbers == pytest.approx(expected_of(expected, f"nuscenes/{label}/"), abs=1e-9)


def test_kitti_numbers_equal_the_definition(scored: tuple[ComparisonMetrics, dict[str, float]]) -> None:
    """AP_BEV and AP_3D at both overlaps equal those of the kit's procedure in plain loops."""
    comparison, expected = scored
    for label in ("car", "bicycle"):
        score = next(score for score in comparison.kitti.classes if score.label == label)
        numbers = {
            f"{name}@{part.min_iou}": getattr(part, name) for part in score.overlaps for name in ("ap_bev", "ap_3d")
        }
        assert numbers == pytest.approx(expected_of(expected, f"kitti/{label}/"), abs=1e-12)


def argoverse_numbers(score: ArgoverseClass) -> dict[str, float | None]:
    """Name our Argoverse numbers as av2 does."""
    return {"ap": score.ap, "ate": score.ate_m, "ase": score.ase, "aoe": score.aoe_rad, "cds": score.cds}


def test_argoverse_numbers_equal_av2(scored: tuple[ComparisonMetrics, dict[str, float]]) -> None:
    """AP, the three errors and CDS equal av2."""
    comparison, expected = scored
    for label in ("car", "bicycle"):
        score = next(score for score in comparison.argoverse.classes if score.label == label)
        assert argoverse_numbers(score) == pytest.approx(expected_of(expected, f"argoverse/{label}/"), abs=1e-9)


def waymo_numbers(score: WaymoClass) -> dict[str, float]:
    """Name our Waymo numbers by range; Waymo says 0 where we say None."""
    parts: list[tuple[str, WaymoRange]] = [("all", score.overall)]
    parts += [(f"{part.lower_m:.0f}", part) for part in score.ranges]
    numbers: dict[str, float] = {}
    for name, part in parts:
        numbers |= {
            f"{name}/ap": part.ap or 0.0,
            f"{name}/let_ap": part.let_ap or 0.0,
            f"{name}/let_apl": part.let_apl or 0.0,
        }
    return numbers


def test_waymo_numbers_equal_waymos_operation(scored: tuple[ComparisonMetrics, dict[str, float]]) -> None:
    """AP, LET-3D-AP and LET-3D-APL of every range equal Waymo's own operation."""
    comparison, expected = scored
    for label in ("car", "bicycle"):
        score = next(score for score in comparison.waymo.classes if score.label == label)
        recorded = expected_of(expected, f"waymo/{label}/")
        # Waymo computes in single precision
        assert {name: waymo_numbers(score)[name] for name in recorded} == pytest.approx(recorded, abs=2e-6)
