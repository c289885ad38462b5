"""What a leaderboard keeps of a submission's uncertainty: replicates and intervals of mDS and the detection scores.

The resamples are the same for all submissions of one ground truth, so any two of them can be compared from what is kept
(`compare_replicates`), and all of them ranked (evaluator/standings.py). Nothing of a single image is in it.
"""

from dataclasses import dataclass
from typing import Self

import msgspec
import numpy as np

from evaluator import array_file
from evaluator.confidence import LEVEL, Interval
from evaluator.errors import UsageError
from evaluator.interval_rules import can_be_resampled
from evaluator.predictions import Float64Array
from evaluator.replicates import MEANS, METRICS
from evaluator.resampling import Unit
from evaluator.statistics import Statistics
from evaluator.uncertainty import RESAMPLES, SEED, bootstrap, named_intervals

MDS = "mds"
DETECTION_SCORE = "detection_score"


class Draw(msgspec.Struct, frozen=True, kw_only=True):
    """How the resamples were drawn: replicates of equal draws, on the same images, can be compared."""

    resamples: int = RESAMPLES
    seed: int = SEED
    unit: Unit = "image"
    level: float = LEVEL


STANDARD_DRAW = Draw()


class _Facts(msgspec.Struct, frozen=True):
    draw: Draw
    intervals: dict[str, Interval | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreReplicates:
    """Replicates of one score, with its C classes, on R resamples."""

    draw: Draw
    mds: Float64Array
    """(R,), NaN where undefined."""
    detection_scores: dict[str, Float64Array]
    """(R,) by label, NaN where undefined."""
    intervals: dict[str, Interval | None]
    """Of `MDS` and of the detection score of each label; None where none is given."""

    def to_bytes(self) -> bytes:
        """Write everything to deterministic bytes (evaluator/array_file.py)."""
        facts = msgspec.to_builtins(_Facts(self.draw, self.intervals))
        return array_file.pack(facts, {MDS: self.mds, **self.detection_scores})

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote.

        Raises:
            ArrayFileError: The bytes are something else or are cut short.
        """
        raw, arrays = array_file.unpack(data)
        try:
            facts, mds = msgspec.convert(raw, _Facts), arrays.pop(MDS)
        except (msgspec.ValidationError, KeyError) as error:
            message = "The array file does not hold replicates of a score; resample the statistics again."
            raise array_file.ArrayFileError(message) from error
        return cls(draw=facts.draw, mds=mds, detection_scores=arrays, intervals=facts.intervals)


def score_replicates(statistics: Statistics, draw: Draw = STANDARD_DRAW) -> ScoreReplicates:
    """Compute what is kept of a score.

    Args:
        statistics: Outcomes of one submission.
        draw: How to resample.

    Returns:
        Replicates and intervals.

    Raises:
        UsageError: There are not enough images to resample, or the protocol's detection scores cannot be.
    """
    column = METRICS.index(DETECTION_SCORE)
    if not can_be_resampled(statistics.protocol)[column]:
        message = f"Detection scores of the protocol {statistics.protocol.name} cannot be resampled."
        raise UsageError(f"{message} Evaluate with cityscapes3d for intervals.")
    found = bootstrap(statistics, resamples=draw.resamples, seed=draw.seed, unit=draw.unit)
    means, of_classes, _ = named_intervals(statistics, found, draw.level)
    classes = found.drawn.classes[:, :, column]
    by_label = {label: of_classes[label][DETECTION_SCORE] for label in statistics.labels}
    return ScoreReplicates(
        draw=draw,
        mds=np.ascontiguousarray(found.drawn.means[:, MEANS.index(MDS)]),
        detection_scores={
            label: np.ascontiguousarray(classes[:, index]) for index, label in enumerate(statistics.labels)
        },
        intervals={MDS: means[MDS], **by_label},
    )
