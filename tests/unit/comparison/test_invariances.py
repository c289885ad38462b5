"""Every comparison metric, classified by what changes it. A metric nobody classified fails here.

Each disturbance does one thing to a scene of many boxes. It must change the metrics that list it, and no other.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from evaluator.comparison.summary import comparison_metrics
from tests.array_factories import Box, Rectangle, disturbed_boxes, make_ground_truth, make_predictions, scattered_boxes
from tests.struct_numbers import Numbers, changed_fields, numbers_by_field

IMAGES = 6
EVERYWHERE: Rectangle = (0.0, 0.0, 2048.0, 1024.0)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is compared."""

    truth: list[Box]
    found: list[Box]
    ignore: list[tuple[int, Rectangle]] = field(default_factory=list)

    def numbers(self) -> Numbers:
        """Return every number of the comparison by its field."""
        truth = make_ground_truth(self.truth, images=IMAGES, ignore=self.ignore)
        return numbers_by_field(comparison_metrics(truth, make_predictions(self.found, images=IMAGES)))


TRUTH = scattered_boxes(11, images=IMAGES, per_image=16)
SCENE = Scene(truth=TRUTH, found=disturbed_boxes(12, TRUTH, images=IMAGES, spread=0.5))
BEFORE = SCENE.numbers()


def turned(box: Box, axis: tuple[float, float, float], angle: float) -> Box:
    """Return the box turned about one of its own axes by `angle`."""
    w, x, y, z = box.quaternion()
    c, (i, j, k) = np.cos(angle / 2), np.array(axis) * np.sin(angle / 2)
    product = (
        w * c - x * i - y * j - z * k,
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
    )
    return with_rotation(box, product)


def with_rotation(box: Box, quaternion: tuple[float, ...]) -> Box:
    """Return the box with another quaternion."""
    w, x, y, z = map(float, quaternion)
    return replace(box, rotation=(w, x, y, z))


def predictions(change: Callable[[Box], Box]) -> Callable[[Scene], Scene]:
    """Do the same to every prediction."""
    return lambda scene: replace(scene, found=[change(box) for box in scene.found])


def both(change: Callable[[Box], Box]) -> Callable[[Scene], Scene]:
    """Do the same to every box of either side."""
    return lambda scene: replace(predictions(change)(scene), truth=[change(box) for box in scene.truth])


def moved(box: Box, ahead: float, left: float, up: float) -> Box:
    """Return the box at another place, metres."""
    x, y, z = box.center
    return replace(box, center=(x + ahead, y + left, z + up))


def grown(box: Box, *factors: float) -> Box:
    """Return the box with its length, width and height multiplied."""
    length, width, height = (side * factor for side, factor in zip(box.dimensions, factors, strict=True))
    return replace(box, dimensions=(length, width, height))


def shuffled(scene: Scene) -> Scene:
    """Put the boxes of every image into another order (scores are distinct)."""
    order = np.random.default_rng(0).permutation
    return replace(
        scene,
        truth=[scene.truth[i] for i in order(len(scene.truth))],
        found=[scene.found[i] for i in order(len(scene.found))],
    )


def with_objects_at(distance_m: float) -> Callable[[Scene], Scene]:
    """Add to every image an object that is not found and a prediction of nothing."""

    def add(scene: Scene) -> Scene:
        far = [Box(image=image, center=(distance_m, 0.0, 0.8), score=0.9) for image in range(IMAGES)]
        nothing = [replace(box, center=(distance_m, 20.0, 0.8)) for box in far]
        return replace(scene, truth=scene.truth + far, found=scene.found + nothing)

    return add


DISTURBANCES = {
    "place": predictions(lambda box: moved(box, 0.9, -0.5, 0.0)),
    "height above ground": predictions(lambda box: moved(box, 0.0, 0.0, 1.5)),
    "length and width": predictions(lambda box: grown(box, 1.4, 0.8, 1.0)),
    "height": predictions(lambda box: grown(box, 1.0, 1.0, 2.0)),
    "heading": predictions(lambda box: turned(box, (0, 0, 1), 0.4)),
    "facing backwards": predictions(lambda box: turned(box, (0, 0, 1), np.pi)),
    "pitch": predictions(lambda box: turned(box, (0, 1, 0), 0.3)),
    "roll": predictions(lambda box: turned(box, (1, 0, 0), 0.3)),
    "sign of the quaternion": predictions(lambda box: with_rotation(box, tuple(-q for q in box.quaternion()))),
    "length of the quaternion": both(lambda box: with_rotation(box, tuple(3 * q for q in box.quaternion()))),
    "order of scores": predictions(lambda box: replace(box, score=1 - box.score)),
    "scores, order kept": predictions(lambda box: replace(box, score=box.score**3)),
    "order of images": both(lambda box: replace(box, image=(5 * box.image + 2) % IMAGES)),
    "order of boxes": shuffled,
    "modal boxes": predictions(lambda box: replace(box, modal=(3.0, 4.0, 50.0, 60.0))),
    "ignore regions": lambda scene: replace(scene, ignore=[(image, EVERYWHERE) for image in range(3)]),
    "objects at 120 m": with_objects_at(120.0),
    "objects at 170 m": with_objects_at(170.0),
}

NEUTRAL = {
    "pitch", "roll", "sign of the quaternion", "length of the quaternion", "order of images", "order of boxes", "modal boxes",
}  # fmt: skip
"""What changes no comparison metric."""
MATCHING = {"place", "order of scores", "ignore regions"}
"""What changes every comparison metric."""
FAR = {"objects at 120 m", "objects at 170 m"}
SIZE = {"length and width", "height"}
HEADING = {"heading", "facing backwards"}
VOLUME = MATCHING | FAR | SIZE | {"height above ground", "heading"}
READ_AT_SCORES = {"scores, order kept"}
"""nuScenes reads errors at scores between those of the matches; Waymo cuts at 101 scores."""
IN_SPACE = MATCHING | {"height above ground"}
"""Argoverse matches in space, nuScenes on the ground."""

CHANGED_BY: dict[str, set[str]] = {
    "KittiAp.ap_bev": MATCHING | FAR | {"length and width", "heading"},
    "KittiAp.ap_3d": VOLUME,
    "NuscenesScores.map": MATCHING,
    "NuscenesScores.mate_m": MATCHING | READ_AT_SCORES,
    "NuscenesScores.mase": MATCHING | READ_AT_SCORES | SIZE,
    "NuscenesScores.maoe_rad": MATCHING | READ_AT_SCORES | HEADING,
    "NuscenesScores.nds3": MATCHING | READ_AT_SCORES | SIZE | HEADING,
    "NuscenesClass.ap": MATCHING,
    "NuscenesClass.ap_by_distance": MATCHING,
    "NuscenesClass.ate_m": MATCHING | READ_AT_SCORES,
    "NuscenesClass.ase": MATCHING | READ_AT_SCORES | SIZE,
    "NuscenesClass.aoe_rad": MATCHING | READ_AT_SCORES | HEADING,
    "WaymoRange.ap": VOLUME | READ_AT_SCORES,
    "WaymoRange.let_ap": VOLUME | READ_AT_SCORES,
    "WaymoRange.let_apl": VOLUME | READ_AT_SCORES,
    "ArgoverseScores.map": IN_SPACE | {"objects at 120 m"},
    "ArgoverseScores.mcds": IN_SPACE | SIZE | HEADING | {"objects at 120 m"},
    "ArgoverseClass.ap": IN_SPACE | {"objects at 120 m"},
    "ArgoverseClass.ap_by_distance": IN_SPACE | {"objects at 120 m"},
    "ArgoverseClass.ate_m": IN_SPACE,
    "ArgoverseClass.ase": IN_SPACE | SIZE,
    "ArgoverseClass.aoe_rad": IN_SPACE | HEADING,
    "ArgoverseClass.cds": IN_SPACE | SIZE | HEADING | {"objects at 120 m"},
}
"""A metric -> the disturbances that change it; nuScenes looks no farther than 100 m, Argoverse than 150 m."""

NO_METRICS = {"label", "ground_truth_count", "min_iou", "lower_m", "upper_m"}
NO_RESULTS = {
    "ComparisonSignature", "KittiParameters", "NuscenesParameters", "WaymoParameters", "Tolerance", "ArgoverseParameters",
}  # fmt: skip


def test_every_comparison_metric_is_classified() -> None:
    """A new number of a benchmark must be added to the table above."""
    fields = {tuple(name.split(".")) for name in BEFORE}
    metrics = {f"{struct}.{name}" for struct, name in fields if struct not in NO_RESULTS and name not in NO_METRICS}

    assert metrics == CHANGED_BY.keys()


def test_every_disturbance_is_classified() -> None:
    """It changes what lists it, or is neutral on purpose."""
    assert set().union(*CHANGED_BY.values()) == DISTURBANCES.keys() - NEUTRAL


@pytest.mark.parametrize("disturbance", DISTURBANCES)
def test_metrics_react_to_what_they_list_and_to_nothing_else(disturbance: str) -> None:
    """What changes one property changes the metrics that measure it, and no other."""
    after = DISTURBANCES[disturbance](SCENE).numbers()

    expected = {metric for metric, what in CHANGED_BY.items() if disturbance in what}
    assert changed_fields(BEFORE, after, CHANGED_BY) == expected
