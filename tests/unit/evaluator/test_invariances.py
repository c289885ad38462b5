"""Every public metric, classified by what changes it and what does not. A metric nobody classified fails here.

Boxes are matched by their submitted modal boxes in these tests, detached from the 3D boxes, or, by the protocol `paper`, by
however little of the projected ones. So each 3D property can be disturbed without changing what matches, and must change its
own metrics and no other.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import ModuleType

import msgspec
import numpy as np
import pytest

from evaluator import overlap, paper_matching, true_positive_metrics
from evaluator.evaluation import Evaluation, evaluate
from evaluator.predictions import Float64Array, Predictions
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol
from evaluator.replicates import BIN_METRICS, MEANS, METRICS, Replicates, replicate
from evaluator.resampling import bootstrap_weights
from evaluator.results import ClassScore, DepthBin, Scores
from tests.array_factories import Box, image_names, make_ground_truth, make_predictions

MODAL = msgspec.structs.replace(CITYSCAPES3D, modal=True)
LOOSE_PAPER = msgspec.structs.replace(PAPER, min_iou=0.05, working_point=0.0)
"""It always matches projected boxes; a disturbed box still has this much in common with itself. With c_w fixed a ranking
changes AP alone, not which boxes the similarities are of."""
RULES = pytest.mark.parametrize("protocol", [MODAL, LOOSE_PAPER], ids=lambda protocol: protocol.name)

POSITION, HEADING, TILT, SIZE, RANKING = "position", "heading", "tilt", "size", "ranking"

CHANGED_BY: dict[str, set[str]] = {
    "ap": {RANKING},
    "bevcd": {POSITION},
    "yaw_sim": {HEADING},
    "pr_sim": {TILT},
    "size_sim": {SIZE},
    "detection_score": {RANKING, POSITION, HEADING, TILT, SIZE},
}
"""A class's metric -> the disturbances that may change it; it must not react to the others."""

NO_METRICS = {"label", "ground_truth_count", "working_point", "recall", "precision", "depth_bins"}
MEAN_OF = {
    "mds": "detection_score",
    "map": "ap",
    "mbevcd": "bevcd",
    "myaw_sim": "yaw_sim",
    "mpr_sim": "pr_sim",
    "msize_sim": "size_sim",
}

SYMMETRIC = {
    "center_similarity", "yaw_similarity", "pitch_roll_similarity", "size_similarity",
    "intersections_px", "intersections_over_unions", "plain_ious",
}  # fmt: skip
"""Functions of two boxes that do not care which is the ground truth."""
DIRECTED = {"covered_fractions"}
"""The fraction of the prediction in a region is not that of the region in the prediction."""
NO_COMPARISONS = {
    "corners_px", "areas_px", "plain_areas_px", "pair_similarities", "mean_over_bins", "integral_over_range",
    "match_by_paper", "projected_boxes",
}  # fmt: skip
"""Functions of these modules that do not compare two boxes, or only bundle those that do."""


def _disturb(predictions: Predictions, what: str) -> Predictions:
    if what == POSITION:
        return replace(predictions, center_m=predictions.center_m + np.array([0.4, -0.3, 0.0]))
    if what == SIZE:
        return replace(predictions, dimensions_m=predictions.dimensions_m * np.array([1.1, 0.9, 1.2]))
    if what == RANKING:
        return replace(predictions, score=predictions.score[::-1].copy())
    w, z, y = (0.98, 0.2, 0.0) if what == HEADING else (0.98, 0.0, 0.2)
    return replace(predictions, rotation=np.tile([w, 0.0, y, z], (len(predictions), 1)))


def _evaluation(
    disturbance: str | None = None, image_of: Sequence[int] = (0,) * 7, protocol: Protocol = MODAL
) -> Evaluation:
    """Evaluate six cars found and one that is none; `image_of` says which image each of the seven is in."""
    truth = [Box(image=image_of[i], center=(10.0 + 12 * i, 0, 0.75), amodal=(150.0 * i, 0, 100, 100)) for i in range(6)]
    right = [replace(box, score=0.9 - 0.1 * i) for i, box in enumerate(truth)]
    wrong = [Box(image=image_of[6], center=(30.0, 5, 0.75), amodal=(1500, 500, 50, 50), score=0.65)]
    images = max(image_of) + 1
    predictions = make_predictions([*right, *wrong], images=images)
    changed = predictions if disturbance is None else _disturb(predictions, disturbance)
    return evaluate(make_ground_truth(truth, images=images), changed, protocol)


def _scores(disturbance: str | None = None, protocol: Protocol = MODAL) -> Scores:
    return _evaluation(disturbance, range(7), protocol).scores


def _value(scores: Scores, metric: str) -> float:
    value: float = getattr(scores.classes[0], metric)
    return value


def test_every_metric_of_a_class_is_classified() -> None:
    """A new field of a result must be added to the table above."""
    assert set(ClassScore.__struct_fields__) == CHANGED_BY.keys() | NO_METRICS


def test_every_metric_of_a_depth_bin_is_one_of_its_class() -> None:
    """Depth bins have no metric of their own."""
    counts = {"lower_m", "upper_m", "ground_truth_count", "true_positive_count", "recall", "precision"}

    assert set(DepthBin.__struct_fields__) - counts <= CHANGED_BY.keys()


def test_every_mean_is_the_mean_of_a_classified_metric() -> None:
    """Means move exactly when the metric of the only class does."""
    scores = _scores()

    assert set(Scores.__struct_fields__) == MEAN_OF.keys() | {"signature", "thresholds", "classes"}
    for mean, metric in MEAN_OF.items():
        assert getattr(scores, mean) == _value(scores, metric)


@RULES
@pytest.mark.parametrize("disturbance", [POSITION, HEADING, TILT, SIZE, RANKING])
@pytest.mark.parametrize("metric", list(CHANGED_BY))
def test_a_metric_reacts_to_its_own_property_and_to_no_other(metric: str, disturbance: str, protocol: Protocol) -> None:
    """Moving, turning, tilting, resizing or re-ranking the boxes changes what it should, for the worse."""
    before, after = (_value(_scores(what, protocol), metric) for what in (None, disturbance))

    if disturbance in CHANGED_BY[metric]:
        assert after < before
    else:
        assert after == pytest.approx(before, abs=1e-12)


WEIGHTS = bootstrap_weights(image_names(7), resamples=20, seed=1)


def _replicates(disturbance: str | None = None, protocol: Protocol = MODAL) -> Replicates:
    """Resample seven images with one prediction each."""
    return replicate(_evaluation(disturbance, range(7), protocol).statistics, WEIGHTS, by_depth=True)


def test_every_resampled_metric_is_classified() -> None:
    """What has an interval is a metric of a class, of a depth bin or a mean, by the same name."""
    assert set(METRICS) == CHANGED_BY.keys()
    assert set(BIN_METRICS) == CHANGED_BY.keys() & set(DepthBin.__struct_fields__)
    assert set(MEANS) == MEAN_OF.keys()


@RULES
@pytest.mark.parametrize("disturbance", [POSITION, HEADING, TILT, SIZE, RANKING])
def test_resampled_metrics_react_to_what_the_metrics_react_to(disturbance: str, protocol: Protocol) -> None:
    """On equal draws a disturbance moves the resamples, and so the intervals, of the same metrics as the scores."""
    before, after = _replicates(None, protocol), _replicates(disturbance, protocol)

    changed = {
        name
        for index, name in enumerate(METRICS)
        if not np.allclose(before.classes[..., index], after.classes[..., index], rtol=0, atol=1e-12, equal_nan=True)
    }
    assert changed == {name for name, what in CHANGED_BY.items() if disturbance in what}


def test_the_order_of_images_means_nothing_to_resamples_of_equal_draws() -> None:
    """Images in another order, each drawn as often as before, give the same resampled metrics, working points and bins."""
    order = [3, 0, 6, 2, 5, 1, 4]
    weights = np.empty_like(WEIGHTS)
    weights[:, order] = WEIGHTS
    shuffled = replicate(_evaluation(image_of=order).statistics, weights, by_depth=True)

    before = _replicates()
    for name in ("classes", "means", "working_point", "true_positives", "depth_bins"):
        assert np.allclose(getattr(shuffled, name), getattr(before, name), rtol=0, atol=1e-12, equal_nan=True), name


def _functions(module: ModuleType) -> dict[str, Callable[..., Float64Array]]:
    return {
        name: function
        for name, function in inspect.getmembers(module, inspect.isfunction)
        if function.__module__ == module.__name__ and not name.startswith("_")
    }


def test_every_function_that_compares_boxes_is_classified() -> None:
    """A new public function of these modules must be added to one of the groups above."""
    public = {name for module in (overlap, paper_matching, true_positive_metrics) for name in _functions(module)}

    assert public == SYMMETRIC | DIRECTED | NO_COMPARISONS


@pytest.mark.parametrize("name", sorted(SYMMETRIC))
def test_symmetric_comparisons_do_not_care_which_side_is_which(name: str) -> None:
    """f(a, b) = f(b, a), bit for bit, so ties stay ties."""
    function = {**_functions(overlap), **_functions(paper_matching), **_functions(true_positive_metrics)}[name]
    rng = np.random.default_rng(4)
    first, second = {
        "center_similarity": lambda: rng.normal(0, 50, (2, 40, 3)),
        "size_similarity": lambda: rng.uniform(0.5, 5, (2, 40, 3)),
        "yaw_similarity": lambda: rng.uniform(-4, 4, (2, 40)),
        "pitch_roll_similarity": lambda: rng.uniform(-4, 4, (2, 2, 40)),
    }.get(name, lambda: np.cumsum(rng.uniform(0, 50, (2, 4, 40)), axis=1)[:, [0, 1, 2, 3]])()
    more = (100.0,) if name == "center_similarity" else ()

    assert np.array_equal(function(first, second, *more), function(second, first, *more))


@pytest.mark.parametrize("name", sorted(DIRECTED))
def test_directed_comparisons_do_care(name: str) -> None:
    """Exchanging the sides changes the value."""
    small, large = np.array([[0.0, 0, 9, 9]]).T, np.array([[0.0, 0, 99, 99]]).T
    function = _functions(overlap)[name]

    assert function(large, small)[0] == pytest.approx(1)
    assert function(small, large)[0] == pytest.approx(0.01)
