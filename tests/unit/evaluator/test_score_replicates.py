"""What a leaderboard keeps of a score."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluator.array_file import ArrayFileError, pack, unpack
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate, signature_of
from evaluator.ground_truth import read_ground_truth
from evaluator.parts import ground_truth_of
from evaluator.protocol import CITYSCAPES3D, PAPER
from evaluator.score_replicates import MDS, Draw, ScoreReplicates, score_replicates
from evaluator.uncertainty import intervals, mds_replicates
from tests.prediction_arrays import load_predictions

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"
DRAW = Draw(resamples=50)


def _evaluate(images: int) -> Evaluation:
    truth = ground_truth_of(read_ground_truth(CASE / "gt"), slice(0, images))
    return evaluate(truth, load_predictions(CASE / "pred", truth.images, CITYSCAPES3D.labels))


def test_replicates_survive_storage() -> None:
    """Everything comes back as it was, undefined values included."""
    kept = score_replicates(_evaluate(60).statistics, DRAW)

    stored = ScoreReplicates.from_bytes(kept.to_bytes())

    assert (stored.draw, stored.intervals) == (kept.draw, kept.intervals)
    assert np.array_equal(stored.mds, kept.mds, equal_nan=True)
    assert stored.detection_scores.keys() == kept.detection_scores.keys()
    for label, row in kept.detection_scores.items():
        assert np.array_equal(stored.detection_scores[label], row, equal_nan=True)


def test_the_kept_numbers_are_those_of_the_library() -> None:
    """Replicates and intervals equal what `mds_replicates` and `intervals` give for the same draw."""
    statistics = _evaluate(60).statistics
    expected = intervals(statistics, resamples=50, by_depth=False)

    kept = score_replicates(statistics, DRAW)

    assert np.array_equal(kept.mds, mds_replicates(statistics, resamples=50))
    assert kept.intervals[MDS] == expected.means["mds"]
    assert kept.intervals["car"] == expected.classes["car"]["detection_score"]


def test_nothing_of_an_image_is_kept() -> None:
    """The size depends on resamples and classes, not on images."""
    few, many = (score_replicates(_evaluate(images).statistics, DRAW) for images in (20, 60))

    # mDS and six classes, 50 doubles each.
    assert sum(row.nbytes for row in (many.mds, *many.detection_scores.values())) == 7 * 50 * 8
    assert abs(len(many.to_bytes()) - len(few.to_bytes())) < 500


def test_one_image_has_no_replicates() -> None:
    """There is nothing to resample."""
    with pytest.raises(UsageError, match="at least 2"):
        score_replicates(_evaluate(1).statistics, DRAW)


def test_the_protocol_paper_has_no_replicates() -> None:
    """Its detection scores do not scatter about the score, so a leaderboard by it says nothing of ranks."""
    statistics = replace(_evaluate(60).statistics, signature=signature_of(PAPER))

    with pytest.raises(UsageError, match="cannot be resampled"):
        score_replicates(statistics, DRAW)


def test_other_bytes_are_refused() -> None:
    """An array file is needed, and one that holds replicates."""
    facts, arrays = unpack(score_replicates(_evaluate(60).statistics, DRAW).to_bytes())
    del arrays[MDS]

    for data in (b"something else", _evaluate(2).statistics.to_bytes(), pack(facts, arrays)):
        with pytest.raises(ArrayFileError):
            ScoreReplicates.from_bytes(data)
