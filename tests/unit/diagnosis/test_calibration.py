"""What scores mean, where c_w lies, how finely scores are told apart."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.diagnosis.calibration import (
    Outcomes,
    ap_all_scores,
    calibrate,
    expected_calibration_error,
    outcomes,
    reliability,
)
from evaluator.diagnosis.working_point import at_working_point
from evaluator.evaluation import Evaluation, evaluate
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions

TRUTH = annotated([Box(center=(12.0 + 10 * i, 4.0 * (i % 3) - 4.0, 0.75)) for i in range(5)])


def evaluation_of(found: list[Box], truth: list[Box] | None = None) -> Evaluation:
    """Evaluate predictions for five cars in five depth bins."""
    return evaluate(make_ground_truth(TRUTH if truth is None else truth), make_predictions(found))


def test_reliability_by_hand() -> None:
    """Each bin tells the mean score and the share of hits; the error weighs the gaps by predictions."""
    found = Outcomes(score=np.array([0.95, 1.0, 0.15, 0.1]), right=np.array([True, True, True, False]))
    bins = reliability(found)
    assert (bins[9].count, bins[9].mean_score, bins[9].precision) == (2, 0.975, 1.0)
    assert (bins[1].count, bins[1].mean_score, bins[1].precision) == (2, 0.125, 0.5)
    assert (bins[5].count, bins[5].mean_score, bins[5].precision) == (0, None, None)
    # (2 x 0.025 + 2 x 0.375) / 4
    assert expected_calibration_error(bins) == pytest.approx(0.2)


def test_without_predictions_calibration_is_undefined() -> None:
    """No predictions have no calibration error."""
    none = Outcomes(score=np.empty(0), right=np.empty(0, dtype=bool))
    assert expected_calibration_error(reliability(none)) is None
    assert ap_all_scores(none, 3) == 0.0


def test_a_prediction_is_judged_among_its_equals() -> None:
    """A confident hit stays a hit although a better box with a low score takes its place at low thresholds."""
    rough = replace(TRUTH[0], center=(12.5, -4.0, 0.75), score=0.9)
    evaluation = evaluation_of([rough, replace(TRUTH[0], score=0.3)])
    found = outcomes(evaluation, at_working_point(evaluation), 0)
    assert found.score.tolist() == [0.9, 0.3]
    # at 0.3 both are active and the exact one has the greater overlap
    assert found.right.tolist() == [True, True]


def test_discarded_and_never_active_predictions_have_no_outcome() -> None:
    """Neither what lies in an ignore region nor what no threshold reaches is right or wrong."""
    truth = make_ground_truth(TRUTH, ignore=[(0, (0.0, 0.0, 100.0, 100.0))])
    far_away = Box(center=(60.0, -2.0, 0.75), modal=(0.0, 0.0, 50.0, 50.0))
    found = make_predictions([far_away, replace(TRUTH[0], score=-0.5), replace(TRUTH[1], score=0.5)])
    evaluation = evaluate(truth, found)
    assert outcomes(evaluation, at_working_point(evaluation), 0).score.tolist() == [0.5]


def test_the_one_working_point_is_compared_with_the_best_of_each_depth() -> None:
    """A depth bin found with low scores only loses everything at a c_w chosen for the others."""
    # four cars found at 0.9, one at 0.5 behind five false positives: p x r is 4/5 at 0.9 and 5/10 at 0.5
    clutter = [Box(center=(70.0, 2.0 * i, 0.75), score=0.6) for i in range(-2, 3)]
    found = [replace(box, score=0.9) for box in TRUTH[:4]] + [replace(TRUTH[4], score=0.5), *clutter]
    evaluation = evaluation_of(found)
    points = calibrate(evaluation, at_working_point(evaluation), 0).depth_working_points
    assert [point.lower_m for point in points] == [10, 20, 30, 40, 50]
    assert [point.loss for point in points] == pytest.approx([0, 0, 0, 0, 1])
    assert points[4].best_threshold == 0.0
    assert points[4].precision_recall == 0.0


def test_scores_squeezed_into_one_level_are_noticed() -> None:
    """Scores that share a level lose the order that AP needs."""
    # hits at 0.999 ... and misses just below, all in [0.98, 1): one threshold sees them all at precision 1/2
    clutter = [Box(center=(70.0, 2.0 * i, 0.75), score=0.981 + 0.001 * i) for i in range(5)]
    found = [replace(box, score=0.991 + 0.001 * i) for i, box in enumerate(TRUTH)] + clutter
    evaluation = evaluation_of(found)
    resolution = calibrate(evaluation, at_working_point(evaluation), 0).resolution
    assert (resolution.used_level_count, resolution.level_count) == (1, 51)
    assert (resolution.prediction_count, resolution.distinct_score_count) == (10, 10)
    assert resolution.fullest_level_share == 1.0
    assert (resolution.ap, resolution.ap_all_scores) == pytest.approx((0.5, 1.0))


def test_scores_below_every_threshold_are_counted() -> None:
    """A negative score never takes part."""
    evaluation = evaluation_of([replace(TRUTH[0], score=-0.1), replace(TRUTH[1], score=0.5)])
    resolution = calibrate(evaluation, at_working_point(evaluation), 0).resolution
    assert (resolution.never_active_count, resolution.used_level_count) == (1, 1)
