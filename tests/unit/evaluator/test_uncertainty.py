"""Bootstrap intervals, comparisons and rank intervals, from stored statistics."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as replace_fields

from evaluator.confidence import LEVEL, Interval
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate, signature_of
from evaluator.ground_truth import read_ground_truth
from evaluator.parts import ground_truth_of
from evaluator.predictions import Float64Array
from evaluator.protocol import CITYSCAPES3D
from evaluator.replicates import METRICS, replicate
from evaluator.resampling import bootstrap_weights, leave_one_out, unit_index
from evaluator.standings import Standings
from evaluator.statistics import Statistics, join
from evaluator.uncertainty import (
    SEED,
    Method,
    compare,
    compare_replicates,
    intervals,
    mds_replicates,
)
from tests.prediction_arrays import load_predictions
from tests.unit.evaluator.textbook_bootstrap import acceleration, bca_shares, bias_correction, quantile

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    """Sixty images of the recorded realistic case."""
    ground_truth = read_ground_truth(CASE / "gt")
    return evaluate(ground_truth, load_predictions(CASE / "pred", ground_truth.images, CITYSCAPES3D.labels))


def test_resamples_draw_as_many_images_as_there_are() -> None:
    """Each resample holds I images in all, and equal seeds draw equally."""
    images = tuple(f"city_{index:06d}_000019" for index in range(50))

    weights = bootstrap_weights(images, resamples=20, seed=1)

    assert weights.sum(axis=1).tolist() == [50] * 20
    assert np.array_equal(weights, bootstrap_weights(images, resamples=20, seed=1))
    assert not np.array_equal(weights, bootstrap_weights(images, resamples=20, seed=2))


def test_clusters_are_drawn_whole() -> None:
    """Images of one sequence or city always count alike."""
    images = ("aachen_000001_000019", "aachen_000001_000020", "aachen_000002_000019", "bonn_000001_000019")

    assert unit_index(images, "image").tolist() == [0, 1, 2, 3]
    assert unit_index(images, "sequence").tolist() == [0, 0, 1, 2]
    assert unit_index(images, "city").tolist() == [0, 0, 0, 1]
    weights = bootstrap_weights(images, resamples=30, seed=1, unit="city")
    assert np.array_equal(weights[:, 0], weights[:, 2])


@pytest.fixture(scope="module")
def repeated(evaluation: Evaluation) -> Statistics:
    """The same sixty images nine times, under other names: enough for intervals."""
    statistics = evaluation.statistics
    again = [replace(statistics, images=tuple(f"{time}{image}" for image in statistics.images)) for time in range(9)]
    return join(again)


@pytest.fixture(scope="module")
def plenty(repeated: Statistics) -> Statistics:
    """Cars alone, of which there are plenty; the mean of one class is enough for an interval."""
    protocol = replace_fields(repeated.protocol, labels=("car",))
    bins = repeated.grid[1]
    own = {
        f"{side}_{column}": getattr(repeated, f"{side}_{column}")[getattr(repeated, f"{side}_cell") < bins]
        for side, columns in COLUMNS.items()
        for column in columns
    }
    return replace(repeated, signature=signature_of(protocol), **own)


COLUMNS = {
    "ground_truth": ("image", "cell"),
    "pair": ("image", "cell", "masks", "score", "similarities"),
    "false_positive": ("image", "cell", "masks", "score"),
}
"""What statistics hold of each kind of box."""


def test_too_few_boxes_are_not_compared(evaluation: Evaluation) -> None:
    """Sixty images give no interval of a difference either."""
    assert set(compare(evaluation.statistics, evaluation.statistics, resamples=10).means.values()) == {None}


@pytest.mark.parametrize("method", ["percentile", "bca"])
def test_intervals_are_reproducible_and_hold_the_estimate(repeated: Statistics, method: Method) -> None:
    """The same call gives the same intervals; the estimate lies inside, in classes and depth bins, too."""
    first = intervals(repeated, resamples=200, method=method)

    assert first == intervals(repeated, resamples=200, method=method)
    assert len(first.depth_bins["car"]) == 20
    for found in (
        first.classes["car"]["ap"],
        first.classes["car"]["detection_score"],
        first.depth_bins["car"][3]["ap"],
    ):
        assert found is not None
        assert found.lower < found.estimate < found.upper


@pytest.mark.parametrize("level", [0.9, 0.95])
def test_intervals_of_average_precision_are_those_of_the_textbook(repeated: Statistics, level: float) -> None:
    """Quantiles of the replicates, and the shares that bias and a jackknife over the images move them to."""
    drawn, left_out = (
        replicate(repeated, weighting).classes[:, 0, METRICS.index("ap")].tolist()
        for weighting in (bootstrap_weights(repeated.images, resamples=201, seed=SEED), leave_one_out(repeated.images))
    )

    tails = (1 - level) / 2, (1 + level) / 2

    ap = _of_car_ap(repeated, level, "percentile")
    assert (ap.lower, ap.upper) == pytest.approx([quantile(drawn, share) for share in tails], abs=1e-12)

    ap = _of_car_ap(repeated, level, "bca")
    shares = bca_shares(bias_correction(ap.estimate, drawn), acceleration(left_out), level)
    assert (ap.lower, ap.upper) == pytest.approx([quantile(drawn, share) for share in shares], abs=1e-12)


def _of_car_ap(statistics: Statistics, level: float, method: Method) -> Interval:
    found = intervals(statistics, resamples=201, level=level, method=method, by_depth=False).classes["car"]["ap"]
    assert found is not None
    return found


def test_the_estimates_are_the_scores(evaluation: Evaluation, repeated: Statistics) -> None:
    """Counting every image nine times changes no score, so the estimates are those of the evaluation."""
    found = intervals(repeated, resamples=20)
    car = evaluation.scores.classes[0]
    ap, in_bin = found.classes["car"]["ap"], found.depth_bins["car"][3]["ap"]

    assert ap is not None
    assert in_bin is not None
    assert (ap.estimate, in_bin.estimate) == pytest.approx((car.ap, car.depth_bins[3].ap), abs=1e-12)


def test_a_higher_level_gives_a_wider_interval(repeated: Statistics) -> None:
    """99 % holds 50 %; what is no level is refused."""
    wide, narrow = (intervals(repeated, resamples=200, level=level, by_depth=False) for level in (0.99, 0.5))
    outer, inner = (found.classes["car"]["ap"] for found in (wide, narrow))

    assert outer is not None
    assert inner is not None
    assert outer.lower < inner.lower < inner.upper < outer.upper
    for level in (0.0, 1.0, -1.0, 95.0):
        with pytest.raises(UsageError, match="between 0 and 1"):
            intervals(repeated, resamples=10, level=level)


def test_depth_bins_may_be_left_out(repeated: Statistics) -> None:
    """Then only means and classes have intervals, the same ones."""
    with_bins, without = (intervals(repeated, resamples=20, by_depth=by_depth) for by_depth in (True, False))

    assert without.depth_bins["car"] == ()
    assert (without.means, without.classes) == (with_bins.means, with_bins.classes)


def test_few_images_give_no_interval(evaluation: Evaluation) -> None:
    """Sixty are fewer than the five hundred an interval needs; their cities are fewer still."""
    found = intervals(evaluation.statistics, resamples=10)

    assert set(found.means.values()) == {None}
    assert {interval for row in found.classes.values() for interval in row.values()} == {None}


def test_a_submission_does_not_differ_from_itself(plenty: Statistics) -> None:
    """Difference 0 on every resample: interval [0, 0], p-value 1."""
    found = compare(plenty, plenty, resamples=50).means["mds"]

    assert found is not None
    assert (found.difference.estimate, found.difference.lower, found.difference.upper) == (0, 0, 0)
    assert found.p_value == 1


def test_the_p_value_is_twice_the_smaller_tail() -> None:
    """Two of 99 differences are at or below 0: p = 2 (2 + 1) / 100."""
    differences = np.concatenate([[-1.0, 0.0], np.full(97, 0.5)])

    found = compare_replicates(0.4, differences)

    assert found is not None
    assert found.p_value == pytest.approx(0.06)


@pytest.mark.parametrize("contrary", [0, 23, 24, 25, 26, 500])
def test_p_value_interval_and_standings_agree(contrary: int) -> None:
    """Of 1000 resamples 24 may be contrary: 2 (24 + 1) / 1001 = 0.04995; 25 make 0.0519."""
    differences = np.concatenate([np.linspace(-1, 0, contrary), np.linspace(0.001, 1, 1000 - contrary)])

    ahead, behind = compare_replicates(0.4, differences), compare_replicates(-0.4, -differences)

    assert ahead is not None
    assert behind is not None
    assert (ahead.p_value, ahead.difference.lower) == (behind.p_value, -behind.difference.upper)
    differs = contrary <= 24
    assert (ahead.p_value <= 1 - LEVEL) == (ahead.difference.lower > 0) == differs
    assert Standings.of([differences, np.zeros(1000)]).groups([0, 1]) == ([] if differs else [[0, 1]])


def test_too_few_resamples_show_no_difference() -> None:
    """Of 38 the smallest p-value is 2 / 39 = 0.051, of 39 it is 0.05."""
    few, enough = ([np.ones(resamples), np.zeros(resamples)] for resamples in (38, 39))

    assert Standings.of(few).groups([0, 1]) == [[0, 1]]
    assert Standings.of(enough).groups([0, 1]) == []


def test_whatever_follows_from_statistics_is_signed_like_them(plenty: Statistics) -> None:
    """Intervals and differences say what they depend on; stored statistics do, too."""
    first, second = (replace(plenty, signature=signature_of(plenty.protocol, "a" * 64, sha256)) for sha256 in "bc")
    assert intervals(first, resamples=10, by_depth=False).signature == first.signature
    assert compare(first, second, resamples=10).signatures == (first.signature, second.signature)
    assert Statistics.from_bytes(first.to_bytes()).signature == first.signature


def test_submissions_on_other_ground_truth_cannot_be_compared(plenty: Statistics) -> None:
    """The images may be the same; their annotations are not."""
    corrected = replace(plenty, signature=signature_of(plenty.protocol, "d" * 64))

    with pytest.raises(UsageError, match="same ground truth"):
        compare(plenty, corrected)


def test_submissions_on_other_images_cannot_be_compared(evaluation: Evaluation) -> None:
    """The message says what is needed."""
    truth = ground_truth_of(evaluation.ground_truth, slice(0, 5))
    other = evaluate(truth, load_predictions(CASE / "pred", truth.images, CITYSCAPES3D.labels))

    with pytest.raises(UsageError, match="same images"):
        compare(evaluation.statistics, other.statistics)


def test_rank_intervals_span_the_ranks_on_the_resamples() -> None:
    """B beats A on half of the resamples, C is always last; equal values share the better rank."""
    mds = np.array([[0.5, 0.5, 0.5, 0.5], [0.4, 0.6, 0.4, 0.6], [0.1, 0.1, 0.1, 0.1]])

    assert Standings.of(mds).rank_intervals() == [(1, 2), (1, 2), (3, 3)]
    assert Standings.of(np.array([[0.5, 0.5], [0.5, 0.5]])).rank_intervals() == [(1, 1), (1, 1)]
    assert Standings.of([]).rank_intervals() == []


def _on_many(mds: list[list[float]]) -> Float64Array:
    """Repeat what each submission has on a few resamples: few alone tell nothing apart."""
    return np.tile(np.array(mds), 20)


def test_an_undefined_mds_ranks_last() -> None:
    """A is undefined on half of the resamples and best on the others, B never is; C never has any."""
    nan = float("nan")

    standings = Standings.of(_on_many([[0.9, nan, 0.9, nan], [0.5, 0.5, 0.5, 0.5], [nan, nan, nan, nan]]))

    # Where A is undefined it shares rank 2 with C.
    assert standings.rank_intervals() == [(1, 2), (1, 2), (2, 3)]
    # B beats C on every resample, A does not.
    assert standings.groups([0, 1, 2]) == [[0, 1]]


def test_groups_join_neighbours_whose_difference_may_be_chance() -> None:
    """A and B trade places; B and C, too; A always beats C: two overlapping groups."""
    mds = _on_many([[0.6, 0.5, 0.6, 0.5], [0.5, 0.6, 0.45, 0.45], [0.4, 0.4, 0.46, 0.4]])

    assert Standings.of(mds).groups([0, 1, 2]) == [[0, 1], [1, 2]]


def test_a_submission_apart_from_all_others_is_in_no_group() -> None:
    """A always leads, B and C trade places."""
    mds = _on_many([[0.9, 0.9], [0.5, 0.4], [0.4, 0.5]])

    assert Standings.of(mds).groups([0, 1, 2]) == [[1, 2]]


def test_a_submission_added_later_stands_as_if_it_had_been_there() -> None:
    """Ranks and differences of all are those of comparing everybody at once, in another order of rows."""
    rng = np.random.default_rng(4)
    mds = rng.normal(rng.uniform(0.3, 0.6, 12)[:, None], 0.05, (12, 200))

    together, added = Standings.of(mds[::-1]), Standings.of(mds[1:]).adding(mds[0])

    assert added.rank_intervals()[-1] == together.rank_intervals()[-1]
    assert added.rank_intervals()[:-1] == together.rank_intervals()[-2::-1]
    assert added.apart[-1, :-1].tolist() == together.apart[-1, -2::-1].tolist()


def test_stored_statistics_give_the_same_replicates(evaluation: Evaluation) -> None:
    """Statistics survive storage bit for bit, so uncertainty can be asked for later."""
    stored = Statistics.from_bytes(evaluation.statistics.to_bytes())

    assert stored.to_bytes() == evaluation.statistics.to_bytes()
    assert np.array_equal(mds_replicates(stored, resamples=20), mds_replicates(evaluation.statistics, resamples=20))
